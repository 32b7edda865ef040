"""The renderers: speed, accuracy, and likeness to real sensors."""
