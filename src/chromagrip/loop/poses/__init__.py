"""Single pictures: render an object on the fingertip, with ground truth."""
