"""Layouts of other tools that a dataset is written in."""

from .layouts import export as export
