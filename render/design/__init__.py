"""Sensor designs: skin, layout of the markers, layers, camera and ground, read from TOML."""
