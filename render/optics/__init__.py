"""Cameras: projection, refraction at the silicone, calibration targets."""
