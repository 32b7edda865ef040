"""Compiled mechanics: springs, contact, friction and the implicit step."""
