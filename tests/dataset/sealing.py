"""Checksums that fit what was changed, as somebody makes them who wants to be read."""

import hashlib
import json
from contextlib import suppress
from pathlib import Path

from chromagrip.dataset.folder import FILES, MANIFEST


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def sealed(folder: Path) -> None:
    """Make the checksums of a dataset fit its files; what is damaged itself stays as it is."""
    lists = (*folder.glob(f"sequence-*/{FILES}"), folder / MANIFEST)
    for path in filter(Path.is_file, lists):  # /dev/zero has no end
        with suppress(OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
            listed = json.loads(path.read_text("utf-8"))
            files = {path.parent / name: (listed["files"], name) for name in listed["files"]}
            if path.name == MANIFEST:
                own = listed["sequences"]
                files |= {folder / name / FILES: (own, name) for name in own}
            for file, (entries, name) in files.items():
                if file.is_file():
                    entries[name] = digest(file)
            path.write_text(json.dumps(listed), "utf-8")
