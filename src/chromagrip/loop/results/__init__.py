"""Results of a run: figure, video, log and report."""
