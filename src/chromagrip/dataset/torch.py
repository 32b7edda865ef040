"""Frames of a dataset for PyTorch; needs the extra `learn`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..extras import need
from ..strange_files import array_names, read_arrays
from .folder import Place
from .labels import STATES
from .pictures import Pictures
from .read import load_sequence, names_of
from .remote import fetched


class Frames:
    """Pictures of a dataset with their labels; a map-style dataset for a `DataLoader`.

    An item is a dictionary: `image`, uint8 (3, H, W); `rest`, the same of the untouched sensor;
    `sequence` and `frame`, numbers; and each label, float32 or bool. Tables are read when the
    dataset is made, pictures when an item is read, so that workers do not share state.

    Parameters
    ----------
    folder: folder of the dataset, or its address
    part: part of its split (default: all sequences)
    labels: columns of the frames, the markers and the nodes, and labels of pixels (`flow`, `depth`,
        …) if the dataset has them
    noise: standard deviation of the noise added to the pictures [grey levels]
    seed: seed of the noise, which depends only on it and the index
    with_rest: whether items have `rest`
    follow_links: whether links in the folder may lead out of it, as in caches of hubs

    Raises
    ------
    UserError
        For a folder without a dataset, an unknown part or an unknown label.
    """

    def __init__(
        self,
        folder: Place,
        part: str | None = None,
        labels: Sequence[str] = ("normal_n", "friction_n", "mu", "margin"),
        *,
        noise: float = 0.0,
        seed: int = 0,
        with_rest: bool = False,
        follow_links: bool = False,
    ) -> None:
        from_numpy = need("torch", "learn").from_numpy
        folder = fetched(folder, follow_links)
        if not noise >= 0.0:
            raise UserError(f"noise = {noise} must not be negative")
        self._noise, self._seed, self._with_rest = noise, seed, with_rest
        self._pictures: list[Pictures] = []
        self._places: list[tuple[int, int]] = []
        parts: dict[str, list[NDArray[Any]]] = {label: [] for label in labels}
        self._pixels: list[str] = []
        for name in names_of(folder, part):
            one = load_sequence(folder / name)
            # A name of both, such as normal_n of a chain, is of the frame.
            columns = {**one.frames, **one.markers, **one.frames}
            self._pixels = [label for label in labels if label not in columns]
            _check_labels(self._pixels, folder / name, columns)
            for label in parts.keys() - set(self._pixels):
                parts[label].append(_numbers(columns[label], label))
                _check_lengths(label, parts[label])
            self._pictures += [one.pictures] * len(one.pictures)
            self._places += [(one.number, t) for t in range(len(one.pictures))]
        self._labels = {
            label: from_numpy(np.concatenate(values)) for label, values in parts.items() if values
        }

    def __len__(self) -> int:
        """Number of frames."""
        return len(self._pictures)

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Picture and labels of a frame."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        index %= len(self)
        number, frame = self._places[index]
        item = {label: values[index] for label, values in self._labels.items()}
        if self._pixels:
            path = self._pictures[index].folder / f"truth-{frame:03d}.npz"
            arrays = read_arrays(path, self._pixels)
            item |= {name: _tensor(values) for name, values in arrays.items()}
        item |= {"sequence": number, "frame": frame, "image": self._image(index)}
        if self._with_rest:
            item["rest"] = _picture(self._pictures[index].rest)
        return item

    def _image(self, index: int) -> Any:
        image = self._pictures[index][self._places[index][1]]
        if self._noise:
            rng = np.random.default_rng([self._seed, index])
            noisy = image + self._noise * rng.standard_normal(image.shape, np.float32)
            image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        return _picture(image)


def _tensor(values: NDArray[Any]) -> Any:
    return need("torch", "learn").from_numpy(values)


def _picture(image: NDArray[np.uint8]) -> Any:
    """Tensor (3, H, W) of a picture (H, W, 3)."""
    return _tensor(np.ascontiguousarray(np.moveaxis(image, -1, 0)))


def _numbers(values: NDArray[Any], label: str) -> NDArray[Any]:
    """Labels as numbers: float32, or bool."""
    words = "slip_state"  # labels of a frame that are words, by the numbers that take their place
    if label == words:
        return np.array([STATES.index(word) for word in values])
    if values.dtype == object:
        raise UserError(f"label {label!r} is words; only numbers can be stacked")
    return values if values.dtype == np.bool_ else values.astype(np.float32)


def _check_lengths(label: str, parts: list[NDArray[Any]]) -> None:
    """Refuse labels whose lists are longer in some sequences than in others."""
    first, last = (np.prod(part.shape[1:], dtype=int) for part in (parts[0], parts[-1]))
    if first != last:
        raise UserError(
            f"label {label!r} has {first} values in some sequences and {last} in others, which "
            "cannot be stacked"
        )


def _check_labels(pixels: Sequence[str], where: Path, columns: dict[str, NDArray[Any]]) -> None:
    """Refuse labels that are in no table and in no file of pixels."""
    if not pixels:
        return
    path = where / "truth-000.npz"
    there: list[str] = []
    if path.is_file():
        there = array_names(path)
    for label in pixels:
        if label not in there:
            raise UserError(
                f"no label {label!r} in {where}; there is {', '.join([*columns, *there])}"
            )
