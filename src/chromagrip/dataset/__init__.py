"""Datasets: labelled sequences of pictures; made, merged, checked, split, exported and read."""

from .check import check as check_dataset
from .export import export as export_dataset
from .folder import sequence_name
from .make import make as make_dataset
from .make import merge as merge_datasets
from .read import Loaded, load_sequences
from .recipe import Recipe, load_recipe
from .split import split as split_dataset

__all__ = [
    "Loaded",
    "Recipe",
    "check_dataset",
    "export_dataset",
    "load_recipe",
    "load_sequences",
    "make_dataset",
    "merge_datasets",
    "sequence_name",
    "split_dataset",
]
