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


#: Extras of `pyproject.toml` by name; its extra `all` holds the first four.
EXTRAS = {
    "images": Extra("skimage", "comparing pictures with each other"),
    "gl": Extra("pyrender", "the renderer pyrender"),
    "mesh": Extra("trimesh", "reading triangle meshes of objects"),
    "rl": Extra("gymnasium", "environments for Gymnasium"),
    "dask": Extra("distributed", "making datasets on a Dask cluster"),
    "ray": Extra("ray", "making datasets on a Ray cluster"),
    "cloud": Extra("fsspec", "a dataset at an address"),
    "learn": Extra("torch", "reading datasets with PyTorch"),
    "live": Extra("viser", "the live page"),
    "ros": Extra("rosbags", "reading a ROS 2 bag or writing an MCAP log"),
    "viz": Extra("rerun", "writing a run as a Rerun log"),
    "mujoco": Extra("mujoco", "sensors in a MuJoCo model"),
    "reference": Extra("mitsuba", "path tracing the reference pictures"),
}


def install_command(*extras: str) -> str:
    """Command that installs these extras."""
    return f"pip install 'chromagrip[{','.join(extras)}]'"


def missing(*extras: str, purpose: str = "") -> str | None:
    """Name the extras that are not installed in one sentence; None if all are.

    Parameters
    ----------
    extras: names in `EXTRAS`
    purpose: use of the extras, as the subject of a sentence (default: the first missing one's)
    """
    absent = [name for name in extras if find_spec(EXTRAS[name].module) is None]
    if not absent:
        return None
    names = " and ".join(f"`{name}`" for name in absent)
    return (
        f"{purpose or EXTRAS[absent[0]].purpose} needs the extra{'s' * (len(absent) > 1)} {names}: "
        f"{install_command(*absent)}"
    )


def require(*extras: str, purpose: str = "") -> None:
    """Refuse if one of these extras is not installed; parameters as in `missing`.

    Raises
    ------
    UserError
        When one is missing.
    """
    problem = missing(*extras, purpose=purpose)
    if problem is not None:
        raise UserError(problem)


def need(module: str, extra: str) -> Any:
    """Import a module that an extra brings.

    Parameters
    ----------
    module: full name of the module, such as `mcap.writer`
    extra: name in `EXTRAS`

    Raises
    ------
    UserError
        When the extra is missing, or its package cannot be imported.
    """
    require(extra)
    try:
        return import_module(module)
    except ImportError as error:
        text = f"{EXTRAS[extra].purpose} is not possible, because {module} cannot be imported"
        raise UserError(f"{text}: {error}; to mend it: {install_command(extra)}") from error
