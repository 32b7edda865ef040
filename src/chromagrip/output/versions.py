"""Versions that results are kept with."""

import platform
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version


def versions() -> dict[str, str]:
    """Versions that decide what a run computes."""
    names = ("chromagrip", "numpy", "scipy", "numba", "opencv-contrib-python-headless", "av")
    found = {"python": platform.python_version()}
    for name in names:
        with suppress(PackageNotFoundError):  # av comes with an extra
            found[name] = version(name)
    return found
