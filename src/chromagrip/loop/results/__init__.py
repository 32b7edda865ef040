"""What a run is shown as: its figure, its video and its report."""
