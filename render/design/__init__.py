"""Sensor designs, read from TOML: skin, marker layout, layers, camera and ground."""

from .sensor import CameraSettings, Geodesic, Ring, Spiral

__all__ = ["CameraSettings", "Geodesic", "Ring", "Spiral"]
