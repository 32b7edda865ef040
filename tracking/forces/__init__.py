"""Forces and friction from tracks."""
