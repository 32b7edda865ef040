"""Versions that results are kept with."""

import platform
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version

from .opencv import loaded_version


def versions() -> dict[str, str]:
    """Versions that decide what a run computes; OpenCV's is that which is loaded."""
    found = {"python": platform.python_version()}
    for name in ("chromagrip", "numpy", "scipy", "numba"):
        found[name] = version(name)
    found["opencv"] = loaded_version() or "unknown"
    with suppress(PackageNotFoundError):  # it comes with an extra
        found["av"] = version("av")
    return found
