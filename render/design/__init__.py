"""Sensor designs: shape, marker layout, skin."""
