"""Calibration of a silicone dome from known presses, by the mechanics of its contacts."""
