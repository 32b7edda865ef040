"""Anybody's tracks scored against the truth of a dataset or of a file."""
