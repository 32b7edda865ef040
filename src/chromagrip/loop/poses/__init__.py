"""Single pictures: an object is put on the fingertip, and its picture taken with all its truth."""
