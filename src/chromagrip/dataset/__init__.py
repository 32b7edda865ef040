"""Datasets: labelled sequences of pictures, made, checked, split and exported."""

from .folder import load_sequences

__all__ = ["load_sequences"]
