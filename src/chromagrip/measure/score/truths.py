"""Truths that tracks are scored against: sequences of a dataset, or a file of points."""

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...dataset.folder import FILES, read_manifest, sequence_name
from ...dataset.pictures import Pictures
from ...dataset.read import Loaded, verified
from ...dataset.recipe import CASE
from ...dataset.remote import fetched
from ...errors import UserError
from ...render import LAYERS, SensorDesign, ground_image, load_sensor, rest_membrane
from ...strange_files import inside
from ..limits.positions import position_limits
from .points import MOST_ROWS, SUFFIXES, Points, read_points
from .scores import Truth

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Named:
    """A truth, the file of the tracks that are scored against it, and its pictures if it has any.

    Attributes
    ----------
    name: of the sequence, or of the file
    truth: true places
    tracks: file of the tracks; None where a tracker cannot follow the sequence
    pictures: of the frames; empty where there are none
    case: of the recipe that the sequence is of; empty where there are none
    """

    name: str
    truth: Truth
    tracks: Path | None
    pictures: Sequence[NDArray[np.uint8]] | Pictures
    case: str = ""


def truths(
    tracks: Path,
    truth: Path,
    refused: Container[str] = (),
    *,
    follow_links: bool = False,
    most: int = MOST_ROWS,
) -> Iterator[Named]:
    """Truths that a file or folder of tracks has something of.

    A folder of tracks has a file, or a folder with `tracks.parquet` (or .csv), for each sequence
    of a dataset, named like it. A single file is of the sequence whose folder is given as the
    truth, or of the one that it is named after, or of a dataset's only one.

    Parameters
    ----------
    refused: sequences that need no tracks, as a tracker cannot follow them
    follow_links: whether links in a dataset or a folder of tracks may lead out of it
    most: rows of a file of a truth that are read at most

    Raises
    ------
    UserError
        When truth or tracks cannot be read, a sequence is damaged, or none has tracks.
    """
    if truth.is_file():
        yield Named(
            name=truth.name,
            truth=Truth(points=read_points(truth, "truth", most)),
            tracks=tracks,
            pictures=[],
        )
        return
    if not truth.is_dir():
        raise UserError(
            f"there is no truth {truth}; wanted: a dataset, one of its sequences, or a file that "
            f"ends in {', '.join(SUFFIXES)}"
        )
    dataset, names = sequences_of(truth, follow_links)
    files = _files_of(tracks, truth, names, refused, follow_links)
    for loaded in verified(dataset, files):  # one after another, as a dataset may be large
        name = sequence_name(loaded.number)
        yield Named(
            name=name,
            truth=_truth(loaded),
            tracks=files[name],
            pictures=loaded.pictures,
            case=str(loaded.values.get(CASE, "")),
        )


def sequences_of(truth: Path, follow_links: bool) -> tuple[Path, list[str]]:
    """Dataset that is the truth, or that a sequence is of, and names of its sequences."""
    alone = (truth / FILES).is_file()
    dataset = fetched(truth.parent if alone else truth, follow_links)
    return dataset, [truth.name] if alone else list(read_manifest(dataset)["sequences"])


def _files_of(
    tracks: Path, truth: Path, names: list[str], refused: Container[str], follow_links: bool
) -> dict[str, Path | None]:
    """File of the tracks of each wanted sequence; None where there need be none."""
    sequence = names == [truth.name]
    wanted = [tracks.stem] if tracks.is_file() and tracks.stem in names else names
    if tracks.is_file() and len(wanted) > 1:
        raise UserError(
            f"{truth} has {len(wanted)} sequences; give the one that {tracks} is of, such as "
            f"{truth / wanted[0]}"
        )
    files = {
        name: tracks if tracks.is_file() else _tracks_of(tracks, name, sequence, follow_links)
        for name in wanted
    }
    missing = [name for name, file in files.items() if file is None and name not in refused]
    if missing:
        raise UserError(
            f"{tracks} has no tracks of {missing[0]}, {len(missing)} of {len(wanted)} sequences "
            f"are missing; wanted: {missing[0]}.parquet or {missing[0]}/tracks.parquet"
        )
    return {name: None if name in refused else file for name, file in files.items()}


def _tracks_of(folder: Path, name: str, alone: bool, follow_links: bool) -> Path | None:
    """File of a sequence's tracks in a folder, which may be of this sequence alone."""
    if not folder.is_dir():
        raise UserError(f"there is no {folder}; wanted: a file or a folder of tracks")
    choices = [f"{name}{suffix}" for suffix in SUFFIXES]
    for folder_name in (f"{name}/", *[""] * alone):
        choices += [f"{folder_name}tracks{suffix}" for suffix in SUFFIXES]
    paths = (inside(folder, choice, follow_links) for choice in choices)
    return next((path for path in paths if path.is_file()), None)


def _truth(loaded: Loaded) -> Truth:
    """Truth of a sequence of a dataset."""
    sensor = load_sensor(loaded.scene.sensor)
    frames, _, count, _ = loaded.places.shape
    position = loaded.places.reshape(frames, -1, 2).astype(float)
    visible = loaded.visible.reshape(frames, -1) & np.isfinite(position).all(axis=2)
    names = [(layer, k) for layer in LAYERS for k in range(count)]
    scale, bound = _at_rest(sensor, loaded.scene.camera.noise_levels)
    return Truth(
        points=Points(names=names, position=position, visible=visible),
        mm_per_px=scale,
        bound=bound,
    )


@lru_cache(maxsize=8)
def _at_rest(sensor: SensorDesign, noise: float) -> tuple[Array, Array]:
    """Millimetres per pixel on the skin, and Cramér–Rao bounds [px], of each marker, (2M,)."""
    membrane = rest_membrane(sensor)
    areas = []
    for layer in membrane.centres:
        jacobian = sensor.view.jacobian(layer)
        # Of the pixels that a step along the skin moves an image by; depth hardly moves it.
        areas.append(np.linalg.svd(jacobian, compute_uv=False)[:, :2].prod(axis=1))
    ground = ground_image(sensor).astype(float)
    limits = position_limits(sensor, membrane, ground, max(noise, np.sqrt(1.0 / 12.0)))
    bound = np.sqrt((limits**2).mean(axis=2))
    return 1e3 / np.sqrt(np.concatenate(areas)), bound.reshape(-1)
