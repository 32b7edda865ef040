"""Published and standard trackers, for comparison."""
