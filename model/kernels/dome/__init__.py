"""Compiled mechanics of the dome: distances, compliance, contact and its Newton steps."""
