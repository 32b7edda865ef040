"""Calibration of a camera's lens, a sensor's mechanics, and a read-out."""
