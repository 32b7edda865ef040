"""The node models, the dome and the pinch: speed, accuracy, and where their steps fail."""
