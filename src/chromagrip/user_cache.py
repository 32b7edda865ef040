"""Folder in which what took long to compute is kept for the user."""

import os
from pathlib import Path


def user_cache() -> Path:
    """The user's cache folder; it is relative where the user has no home and none was chosen."""
    user = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    return Path(os.path.expanduser(user)) / "chromagrip"
