"""Pictures, plots and video of a run with two fingers."""
