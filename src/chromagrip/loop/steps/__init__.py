"""A grasp frame by frame."""
