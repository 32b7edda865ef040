"""Truths that tracks are scored against: sequences of a dataset, or a file of points."""

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...dataset.folder import FILES, read_manifest, sequence_name
from ...dataset.pictures import Pictures
from ...dataset.read import Loaded, load_sequences
from ...dataset.recipe import CASE
from ...errors import UserError
from ...render import LAYERS, SensorDesign, ground_image, load_sensor, rest_membrane
from ..limits.positions import position_limits
from .points import SUFFIXES, Points, read_points
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


def truths(tracks: Path, truth: Path, refused: Container[str] = ()) -> Iterator[Named]:
    """Truths that a file or folder of tracks has something of.

    A folder of tracks has a file, or a folder with `tracks.parquet`, for each sequence of a
    dataset, named like it. A single file is of the sequence whose folder is given as the truth, or
    of the one that it is named after, or of a dataset's only one.

    Parameters
    ----------
    refused: sequences that need no tracks, as a tracker cannot follow them

    Raises
    ------
    UserError
        When truth or tracks cannot be read, or no sequence has tracks.
    """
    if truth.is_file():
        yield Named(
            name=truth.name,
            truth=Truth(points=read_points(truth, "truth")),
            tracks=tracks,
            pictures=[],
        )
        return
    if not truth.is_dir():
        raise UserError(
            f"there is no truth {truth}; wanted: a dataset, one of its sequences, or a file that "
            f"ends in {', '.join(SUFFIXES)}"
        )
    dataset = truth.parent if (truth / FILES).is_file() else truth
    files = _files_of(tracks, truth, dataset, refused)
    for loaded in load_sequences(dataset):  # one after another, as a dataset may be large
        name = sequence_name(loaded.number)
        if name in files:
            yield Named(
                name=name,
                truth=_truth(loaded),
                tracks=files[name],
                pictures=loaded.pictures,
                case=str(loaded.values.get(CASE, "")),
            )


def _files_of(
    tracks: Path, truth: Path, dataset: Path, refused: Container[str]
) -> dict[str, Path | None]:
    """File of the tracks of each wanted sequence; None where there need be none."""
    sequence, everything = truth != dataset, list(read_manifest(dataset)["sequences"])
    if sequence:
        wanted = [truth.name]
    elif tracks.is_file() and tracks.stem in everything:
        wanted = [tracks.stem]
    else:
        wanted = everything
    if tracks.is_file() and len(wanted) > 1:
        raise UserError(
            f"{truth} has {len(wanted)} sequences; give the one that {tracks} is of, such as "
            f"{truth / wanted[0]}"
        )
    alone = tracks / "tracks.parquet"  # of `chromagrip track`
    files = {name: tracks if tracks.is_file() else _tracks_of(tracks, name) for name in wanted}
    if sequence and files[truth.name] is None and alone.is_file():
        files[truth.name] = alone
    missing = [name for name, file in files.items() if file is None and name not in refused]
    if missing:
        raise UserError(
            f"{tracks} has no tracks of {missing[0]}, {len(missing)} of {len(wanted)} sequences "
            f"are missing; wanted: {missing[0]}.parquet or {missing[0]}/tracks.parquet"
        )
    return {name: None if name in refused else file for name, file in files.items()}


def _tracks_of(folder: Path, name: str) -> Path | None:
    """File of a sequence's tracks in a folder."""
    if not folder.is_dir():
        raise UserError(f"there is no {folder}; wanted: a file or a folder of tracks")
    choices = [folder / f"{name}{suffix}" for suffix in SUFFIXES]
    choices += [folder / name / "tracks.parquet"]
    return next((path for path in choices if path.is_file()), None)


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
