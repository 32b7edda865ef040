"""Compiled kernels of the fit of marker pairs."""
