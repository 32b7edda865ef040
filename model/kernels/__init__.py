"""Compiled mechanics: springs, contact, friction and the implicit step."""

from .contact import contact_frames, frictions_at
from .friction import dahl_path

__all__ = ["contact_frames", "dahl_path", "frictions_at"]
