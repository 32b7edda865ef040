"""From a sensor's calibration to its read-out: histories, shifts in pictures, codes, networks."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..folders import LOCK, filling, whole_file, write_arrays
from ..model import Fingertip, rest_state
from ..output.processes import map_processes
from ..render import Defects, SensorDesign
from ..sensing.sensor import TactileSensor
from ..tracking import MarkerTracker, Palette, SensorCalibration
from ..tracking.forces import check_trainable, floor_variances, training_key
from ..tracking.forces.chain import (
    believed,
    circle_places,
    fields_on_circles,
    limited,
    save_readout,
)
from .histories import Snapshots, snapshots
from .learner import Learner
from .networks import Basis, Errors, Lessons, fit_readout, make_basis
from .training_ranges import training_ranges
from .variations import VariationRanges, random_variations, varied_shifts

Array = NDArray[np.float64]

#: Histories of a part, which is the most that an interruption costs.
PART = 250
#: Histories of the basis.
BASIS = 500
#: Variations of specimen and picture that are trained with.
VARIATIONS = VariationRanges()


class _Part(NamedTuple):
    """Numbers of the histories to simulate, and the file of their lessons."""

    numbers: range
    file: Path


def train(
    calibration: SensorCalibration,
    noise: float,
    histories: int,
    epochs: int,
    out: Path,
    workers: int,
    tell: Callable[[str], None],
) -> Errors:
    """Train a read-out and write it; returns the RMS errors on held-out histories.

    Finished parts stay in the folder `out`.parts until the read-out is written: after an
    interruption, a new training computes only the missing parts.

    Parameters
    ----------
    calibration: calibration of the sensor
    noise: standard deviation of a pixel of its camera [grey levels]
    histories: number of histories to learn from
    epochs: number of passes over them
    out: file of the read-out
    workers: number of processes
    tell: function called with the current step, for a progress line

    Raises
    ------
    UserError
        When no read-out can be trained for the sensor, or the folder holds parts of another
        training.
    """
    check_trainable(calibration)
    folder = out.with_name(out.name + ".parts")
    folder.mkdir(exist_ok=True)
    with filling(folder):
        _claim(folder, calibration, noise)
        tell("the noise of a frame")
        if not (folder / "basis.npz").exists():
            write_arrays(folder / "basis.npz", vars(_basis(calibration, noise)))
        basis = Basis(**_read(folder / "basis.npz"))
        parts = [
            _Part(numbers, folder / f"{numbers.start}-{numbers.stop}.npz")
            for first in range(0, histories, PART)
            for numbers in [range(first, min(first + PART, histories))]
        ]
        missing = [part for part in parts if not part.file.exists()]
        done = histories - sum(len(part.numbers) for part in missing)
        simulate = partial(_simulate_part, calibration.fingertip, calibration.sensor, basis)
        with closing(map_processes(simulate, missing, workers)) as counts:
            for count in counts:
                done += count
                tell(f"histories, {done} of {histories}")
        tables = [_read(part.file) for part in parts]
        lessons = Lessons(**{key: np.concatenate([t[key] for t in tables]) for key in tables[0]})
        ranges = training_ranges(VARIATIONS, noise, histories, epochs)
        readout, errors = fit_readout(calibration, basis, lessons, ranges, epochs, tell)
        with whole_file(out) as file:
            save_readout(readout, file)
    shutil.rmtree(folder)
    return errors


def _claim(folder: Path, calibration: SensorCalibration, noise: float) -> None:
    """Write the settings of a training into its folder of parts; refuse those of another."""
    key = training_key(calibration.sensor, calibration.fingertip)
    settings = msgspec.json.encode({"of": msgspec.Raw(key), "noise": noise})
    # File beside the parts that names the sensor and noise that they are of.
    settings_file = "settings.json"
    file = folder / settings_file
    if all(path.name == LOCK for path in folder.iterdir()):
        with whole_file(file) as part:
            part.write_bytes(settings)
    elif not file.exists() or file.read_bytes() != settings:
        raise UserError(
            f"{folder} holds parts of a training with another sensor or noise: finish that one, or "
            "remove the folder"
        )


def _basis(calibration: SensorCalibration, noise: float) -> Basis:
    """Make the basis from the first histories, with the noise of frames at rest."""
    sensor, tip = calibration.sensor, calibration.fingertip
    camera = TactileSensor(sensor, body=tip, noise=noise, defects=Defects()).camera
    tracker = MarkerTracker(Palette.of_sensor(sensor), noise)
    state = rest_state(tip)
    frames_at_rest = 8  # frames at rest from which the noise of the shifts is found
    with closing(camera):
        tracker.reset(camera.expose_rest(state, frames_at_rest))
        tracks = tracker.update(camera.expose(state, 0))
    # Variances of the design's pairs: each that of the nearest pair found.
    places = sensor.view.project(sensor.shape.points(sensor.places, sensor.depths[0]))
    distance = np.linalg.norm(places[:, None] - tracks.position[0], axis=-1)
    distance[:, ~tracks.visible.all(axis=0)] = np.inf
    variance = np.diagonal(tracks.covariance[distance.argmin(axis=1)], axis1=1, axis2=2)
    instants = _flipped(np.random.default_rng([76, 0]), snapshots(tip, range(BASIS)))
    fields = []
    for ranges in (VariationRanges(nominal_share=1.0, azimuth_noise_deg=0.0), VARIATIONS):
        shifts = _shifts(
            np.random.default_rng([76, 1]), sensor, tip, circle_places(), instants, ranges
        )
        parts = [fields_on_circles(limited(some)) for some in shifts]
        fields.append([np.concatenate(both) for both in zip(*parts, strict=True)])
    (designed, _), (even, odd) = fields
    return make_basis(
        instants,
        designed,
        (even, odd),
        sensor.places,
        np.sqrt(variance + believed(floor_variances(calibration))),
        np.sqrt(variance),
    )


def _shifts(
    rng: np.random.Generator,
    sensor: SensorDesign,
    tip: Fingertip,
    places: Array,
    instants: Snapshots,
    ranges: VariationRanges,
) -> Iterator[Array]:
    """Yield shifts of snapshots under random variations, without noise, (S, P, 6) at a time."""
    at_once = 50  # snapshots whose shifts are computed at a time
    for k in range(0, len(instants.totals), at_once):
        chain = instants.displacement[k : k + at_once].astype(float)
        variations = random_variations(rng, chain, ranges)
        yield varied_shifts(sensor, places, tip, chain, variations)


def _flipped(rng: np.random.Generator, instants: Snapshots) -> Snapshots:
    """Mirror a random half of the snapshots in x; the model has this symmetry."""
    turned = rng.random(len(instants.totals)) < 0.5
    flip = np.array([-1.0, 1.0], dtype=np.float32)
    side = np.where(turned, -1.0, 1.0)
    shape = (-1, 1, 1)
    return replace(
        instants,
        displacement=np.where(
            turned.reshape(shape), instants.displacement[:, ::-1] * flip, instants.displacement
        ),
        normal=np.where(turned[:, None], instants.normal[:, ::-1], instants.normal),
        friction=np.where(turned[:, None], -instants.friction[:, ::-1], instants.friction),
        totals=instants.totals * np.stack([np.ones_like(side), side, np.ones_like(side)], axis=1),
    )


def _simulate_part(tip: Fingertip, sensor: SensorDesign, basis: Basis, part: _Part) -> int:
    """Write the lessons of some histories; returns their number."""
    rng = np.random.default_rng([78, part.numbers[0]])
    instants = _flipped(rng, snapshots(tip, part.numbers))
    # The load is turned against the layout, by another angle in each part.
    places = sensor.places - [0.0, rng.uniform(0.0, 2.0 * np.pi)]
    learner = Learner.of(basis, places)
    parts = [
        learner.read(rng, shifts)
        for shifts in _shifts(rng, sensor, tip, places, instants, VARIATIONS)
    ]
    codes, level, context = (np.concatenate(values) for values in zip(*parts, strict=True))
    values = {
        "codes": codes,
        "level": level,
        "context": context,
        "shapes": basis.shapes(instants),
        "totals": instants.totals,
    }
    lessons: dict[str, NDArray[Any]] = {k: v.astype(np.float32) for k, v in values.items()}
    write_arrays(part.file, {**lessons, "history": instants.history})
    return len(part.numbers)


def _read(path: Path) -> dict[str, Array]:
    with np.load(path) as file:
        return {name: file[name] for name in file.files}
