"""Compiled mechanics: springs, contact, friction and the implicit step."""

from .contact import contact_frames

__all__ = ["contact_frames"]
