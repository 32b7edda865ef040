"""A sensor and a reader: a pose or a force in, its picture out; a picture in, forces out."""
