"""Charts of speed against accuracy, one module for each stage."""
