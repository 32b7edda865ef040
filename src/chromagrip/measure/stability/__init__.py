"""Maps of where integrators, trackers and controllers stop working."""
