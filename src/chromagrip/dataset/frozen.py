"""Frozen recipes: a file beside each has SHA-256 of pixels and rounded labels of its sequences."""

import hashlib
import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from .folder import Place, open_recipe, read_manifest
from .labels import READING
from .read import load_sequence
from .recipe import SHIPPED, Recipe, load_recipe
from .remote import fetched


def recorded(recipe: Recipe) -> tuple[str, dict[str, dict[str, str]]]:
    """Name and digests of the frozen recipe that differs at most in count, truth and reading."""
    for file in SHIPPED.iterdir():
        if file.name.endswith(".json"):
            name = file.name.removesuffix(".json")
            asked = {key: getattr(recipe, key) for key in ("sequences", "truth", "reading")}
            if msgspec.structs.replace(load_recipe(name), **asked) == recipe:
                return name, json.loads(file.read_bytes())
    return "", {}


def digests_of(folder: Path) -> dict[str, str]:
    """Digests of a sequence's pixels, and of its labels to three decimals."""
    one = load_sequence(folder)
    levels = np.stack([one.pictures.rest, *one.pictures])
    pictures = hashlib.sha256(repr(levels.shape).encode() + levels.tobytes())
    labels = hashlib.sha256()
    for name, values in (*one.frames.items(), *one.markers.items()):
        if name in READING:
            continue
        labels.update(f"{name} {values.shape}".encode())
        if values.dtype == object:
            labels.update(json.dumps(values.tolist()).encode())
        else:
            rounded = np.round(values.astype("<f8"), 3) + 0.0  # no negative zero
            labels.update(np.where(np.isnan(rounded), np.nan, rounded).tobytes())
    return {"pictures": pictures.hexdigest(), "labels": labels.hexdigest()}


def seal(folder: Place, *, follow_links: bool = False) -> dict[str, Any]:
    """Digest of a dataset of a frozen recipe, compared with its record; empty for another one."""
    folder = fetched(folder, follow_links)
    frozen, record = recorded(open_recipe(folder))
    if not frozen:
        return {}
    found = {name: digests_of(folder / name) for name in read_manifest(folder)["sequences"]}
    same = sum(record.get(name) == one for name, one in found.items())
    text = "".join(f"{name} {one['pictures']} {one['labels']}\n" for name, one in found.items())
    return {
        "digest": hashlib.sha256(text.encode()).hexdigest(),
        "frozen": frozen,
        "as_recorded": f"{same} of {len(found)}",
    }
