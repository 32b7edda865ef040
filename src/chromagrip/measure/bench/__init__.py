"""Benches: one module for each part that `chromagrip bench` measures."""
