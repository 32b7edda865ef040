"""Optional packages: the extra that brings each, its purpose, and the refusal if it is missing.

A package of an extra is imported by `need`, in the function that uses it.
"""

from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from .errors import UserError


@dataclass(frozen=True)
class Extra:
    """A set of optional packages.

    Attributes
    ----------
    module: import name of the package that the extra brings
    purpose: use of the extra, as the subject of a sentence
    """

    module: str
    purpose: str


#: Extras of `pyproject.toml` by name; its extra `all` holds the first six.
EXTRAS = {
    "images": Extra("skimage", "comparing pictures with each other"),
    "gl": Extra("pyrender", "the renderer pyrender"),
    "data": Extra("pyarrow", "reading and writing Parquet tables"),
    "video": Extra("av", "reading and writing videos"),
    "mesh": Extra("trimesh", "reading triangle meshes of objects"),
    "rl": Extra("gymnasium", "environments for Gymnasium"),
    "dask": Extra("distributed", "making datasets on a Dask cluster"),
    "ray": Extra("ray", "making datasets on a Ray cluster"),
    "cloud": Extra("fsspec", "a dataset at an address"),
    "learn": Extra("torch", "reading datasets with PyTorch"),
    "live": Extra("viser", "the live page"),
    "ros": Extra("mcap", "writing a run as an MCAP log"),
    "modbus": Extra("pymodbus", "driving a gripper over Modbus"),
