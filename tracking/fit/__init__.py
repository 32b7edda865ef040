"""The marker fit: both layers of every pair fitted to the pixels."""
