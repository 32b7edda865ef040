"""Versions that results are kept with."""

import platform
from importlib.metadata import version


def versions() -> dict[str, str]:
    """Versions that decide what a run computes."""
    names = ("chromagrip", "numpy", "scipy", "numba", "opencv-contrib-python-headless", "av")
    return {"python": platform.python_version()} | {name: version(name) for name in names}
