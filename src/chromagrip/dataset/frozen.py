"""Frozen recipes: digests of their sequences are recorded with the code.

Digests cover pixels and labels, not files, which name versions and are packed by libraries.
Another kind of processor may round a pixel or a label differently. A sample of both distinguishes
this from other pictures.
"""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from ..errors import UserError
from .folder import Place, open_recipe, read_manifest
from .labels import READING
from .read import load_sequence
from .recipe import SHIPPED, Recipe, load_recipe
from .remote import fetched

#: Result of comparing a sequence with its record.
Likeness = Literal["same", "rounded", "other pictures", "other labels"]

#: Frozen recipes of an earlier version's pictures, and the recipes that replace them.
OLDER = {"benchmark-v1": "benchmark-v2"}
#: Decimals of labels in the digest [px, mm, N and so on].
_DECIMALS = 3


class Content(msgspec.Struct, frozen=True):
    """Digests and samples of a sequence.

    Attributes
    ----------
    pictures, labels: SHA-256 of all pixels, and of all labels, rounded
    pixels: sample of levels, in hexadecimal digits
    values: sample of labels
    """

    pictures: str
    labels: str
    pixels: str
    values: list[float]


@dataclass(frozen=True, kw_only=True)
class Frozen:
    """A recipe whose sequences are recorded.

    Attributes
    ----------
    name: name of the recipe
    sequences: recorded digests, by the name of the sequence
    """

    name: str
    sequences: dict[str, Content]

    def likeness(self, sequence: str, found: Content) -> Likeness:
        """Compare a sequence with its record; a sequence without a record counts as the same."""
        recorded = self.sequences.get(sequence, found)
        if (recorded.pictures, recorded.labels) == (found.pictures, found.labels):
            return "same"
        levels = [np.frombuffer(bytes.fromhex(one.pixels), np.uint8) for one in (recorded, found)]
        off = abs(np.subtract(*levels, dtype=int))
        rounded = 0.02  # share of sampled pixels that rounding may change, by one level
        if off.max() > 1 or off.mean() > rounded:
            return "other pictures"
        label = 2e-3  # largest change of a sampled label by rounding
        near = np.allclose(recorded.values, found.values, rtol=0.0, atol=label)
        return "rounded" if near else "other labels"


def frozen_as(recipe: Recipe) -> Frozen | None:
    """Find the frozen recipe equal to this one, except for sequences, truth, reading, store."""
    for file in sorted(SHIPPED.iterdir(), key=lambda file: file.name):
        name = file.name.removesuffix(".json")
        if name == file.name:
            continue
        asked = {"truth": recipe.truth, "reading": recipe.reading, "store": recipe.store}
        if replace(load_recipe(name), sequences=recipe.sequences, **asked) == recipe:
            recorded = msgspec.json.decode(file.read_bytes(), type=dict[str, Content])
            return Frozen(name=name, sequences=recorded)
    return None


def refuse_older(recipe: Recipe) -> None:
    """Refuse a frozen recipe whose pictures this version does not make."""
    frozen = frozen_as(recipe)
    if frozen is not None and frozen.name in OLDER:
        raise UserError(
            f"{frozen.name} has the noise of an earlier version and is not made again; "
            f"make {OLDER[frozen.name]}"
        )


def content_of(folder: Path) -> Content:
    """Digests and samples of a sequence's folder."""
    one = load_sequence(folder)
    levels = np.stack([one.pictures.rest, *one.pictures])
    labels = {name: values for name, values in one.frames.items() if name not in READING}
    columns = [*labels.items(), *one.markers.items()]
    numbers = [values.ravel() for _, values in columns if values.dtype.kind == "f"]
    known = np.concatenate(numbers).astype(float)
    known = known[np.isfinite(known)]
    pixel_count = 400  # number of pixels in the sample
    label_count = 200  # number of labels in the sample
    return Content(
        pictures=_digest([repr(levels.shape).encode(), levels.tobytes()]),
        labels=_digest(part for name, own in columns for part in _bytes(name, own)),
        pixels=_sampled(levels.ravel(), pixel_count).tobytes().hex(),
        values=np.round(_sampled(known, label_count), _DECIMALS + 1).tolist(),
    )


def seal(folder: Place, *, follow_links: bool = False) -> dict[str, Any]:
    """Digest of a dataset of a frozen recipe, compared with its record; empty for another one."""
    folder = fetched(folder, follow_links)
    frozen = frozen_as(open_recipe(folder))
    if frozen is None:
        return {}
    found = {name: content_of(folder / name) for name in read_manifest(folder)["sequences"]}
    like = [frozen.likeness(name, one) for name, one in found.items()]
    counts = {word: like.count(word) for word in dict.fromkeys(like)}
    return {
        "digest": digest_of(found),
        "frozen": frozen.name,
        "as_recorded": ", ".join(f"{count} {word}" for word, count in counts.items()),
    }


def digest_of(sequences: dict[str, Content]) -> str:
    """One digest of several sequences, in their order."""
    texts = (f"{name} {one.pictures} {one.labels}\n" for name, one in sequences.items())
    return _digest(text.encode() for text in texts)


def _digest(parts: Iterable[bytes]) -> str:
    total = hashlib.sha256()
    for part in parts:
        total.update(part)
    return total.hexdigest()


def _bytes(name: str, values: NDArray[Any]) -> tuple[bytes, bytes]:
    """Name and shape of labels, and their values, rounded; the same on every machine."""
    head = f"{name} {values.shape}".encode()
    if values.dtype == object:
        return head, json.dumps(values.tolist()).encode()
    rounded = np.round(values.astype(float), _DECIMALS) + 0.0  # no negative zero
    return head, np.where(np.isnan(rounded), np.nan, rounded).astype("<f8").tobytes()


def _sampled(values: NDArray[Any], count: int) -> NDArray[Any]:
    """Take `count` of the values, evenly."""
    return np.asarray(values[np.linspace(0, len(values) - 1, count).astype(int)])
