"""Calibration of a camera from pictures of a board."""
