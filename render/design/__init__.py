"""Sensor designs: skin, layout of the markers, layers, camera and ground, read from TOML."""

from .sensor import CameraSettings, Geodesic, Ring, Spiral

__all__ = ["CameraSettings", "Geodesic", "Ring", "Spiral"]
