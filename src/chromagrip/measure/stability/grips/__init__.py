"""Maps of where a gripping dome, or two of them, hold, swing, turn or drop an object."""
