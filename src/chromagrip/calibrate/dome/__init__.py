"""Calibration of a dome of silicone from known presses, by the mechanics of its contacts."""
