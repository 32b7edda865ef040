"""Benchmarks of this project itself: `./run bench NAME`. They are no part of the package."""
