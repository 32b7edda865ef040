"""A sensor (pose or force in, picture out) and a reader (picture in, forces out)."""
