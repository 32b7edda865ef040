"""Measurements of this project itself; only the command line imports them."""
