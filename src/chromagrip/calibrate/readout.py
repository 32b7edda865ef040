"""From a sensor's calibration to its read-out: histories, shifts in pictures, codes, networks."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..extras import require
from ..loop.camera import SimulatedCamera
from ..model import Fingertip, rest_state
from ..output.folder import filling, whole_file
from ..output.processes import map_processes
from ..render import SensorDesign, open_renderer
from ..tracking import MarkerTracker, Palette, SensorCalibration
from ..tracking.forces import MEASURED
from ..tracking.forces.chain import MarkerResponse, limited, save_readout
from .histories import Snapshots, snapshots, with_mirrored
from .networks import Basis, Lessons, fit_readout, make_basis

Array = NDArray[np.float64]

#: Histories of a part, which is the most that an interruption costs.
PART = 250
#: Histories of the basis.
BASIS = 500
#: Share of the instants at which pairs are lost.
_LOSING = 0.3
#: Largest number of pairs that are lost at an instant.
_MOST_LOST = 5
#: Frames at rest from which the noise of the shifts is found.
_FRAMES = 8
#: File beside the parts that names the sensor and noise that they are of.
_SETTINGS = "settings.json"


class _Part(NamedTuple):
    """Histories to simulate, and the file of their lessons."""

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
) -> dict[str, float]:
    """Train a read-out and write it; the RMS errors on histories held out.

    Finished parts stay in the folder `out`.parts until the read-out is written: an interrupted
    training that is started again computes the others only.

    Parameters
    ----------
    calibration: of the sensor
    noise: of its camera [grey levels]
    histories: to learn from
    epochs: passes over them
    out: file of the read-out
    workers: processes
    tell: called with the current step, for a progress line

    Raises
    ------
    UserError
        When scikit-learn is missing, the sensor's markers do not determine forces, or the folder
        holds parts of another training.
    """
    require("learn")
    tip, sensor = calibration.fingertip, calibration.sensor
    response = _response(sensor, tip)  # refuses markers that do not determine forces
    folder = out.with_name(out.name + ".parts")
    folder.mkdir(exist_ok=True)
    with filling(folder):
        _claim(folder, calibration, noise)
        tell("the noise of a frame")
        if not (folder / "basis.npz").exists():
            _write(folder / "basis.npz", vars(_basis(calibration, response, noise)))
        basis = Basis(**_read(folder / "basis.npz"))
        parts = [
            _Part(numbers, folder / f"{numbers.start}-{numbers.stop}.npz")
            for first in range(0, histories, PART)
            for numbers in [range(first, min(first + PART, histories))]
        ]
        missing = [part for part in parts if not part.file.exists()]
        done = histories - sum(len(part.numbers) for part in missing)
        simulate = partial(_simulate_part, tip, sensor, basis)
        with closing(map_processes(simulate, missing, workers)) as counts:
            for count in counts:
                done += count
                tell(f"histories, {done} of {histories}")
        tables = [_read(part.file) for part in parts]
        lessons = Lessons(**{key: np.concatenate([t[key] for t in tables]) for key in tables[0]})
        readout, errors = fit_readout(tip, sensor, basis, lessons, epochs, tell)
        with whole_file(out) as file:
            save_readout(readout, file)
    shutil.rmtree(folder)
    return errors


def _claim(folder: Path, calibration: SensorCalibration, noise: float) -> None:
    """Note in a folder of parts what they are of; refuse parts of another training."""
    settings = msgspec.json.encode(
        {"sensor": calibration.sensor, "fingertip": vars(calibration.fingertip), "noise": noise},
        order="deterministic",
    )
    file = folder / _SETTINGS
    if not any(folder.iterdir()):
        with whole_file(file) as part:
            part.write_bytes(settings)
    elif not file.exists() or file.read_bytes() != settings:
        raise UserError(
            f"{folder} holds parts of a training with another sensor or noise: finish that one, or "
            "remove the folder"
        )


def _basis(calibration: SensorCalibration, response: MarkerResponse, noise: float) -> Basis:
    """Basis of the first histories, with the noise of frames at rest."""
    sensor, tip = calibration.sensor, calibration.fingertip
    camera = SimulatedCamera(sensor, open_renderer("painter", sensor), tip.nodes, noise, seed=0)
    tracker = MarkerTracker(Palette.of_sensor(sensor), noise)
    state = rest_state(tip)
    with closing(camera):
        tracker.reset(camera.expose_rest(state, _FRAMES))
        tracks = tracker.update(camera.expose(state, 0))
    floor = [calibration.position_floor, calibration.position_floor, calibration.size_floor] * 2
    # Variances of the design's pairs, each that of the pair that was found nearest to it.
    places = sensor.view.project(sensor.shape.points(sensor.places, sensor.depths[0]))
    distance = np.linalg.norm(places[:, None] - tracks.position[0], axis=-1)
    distance[:, ~tracks.visible.all(axis=0)] = np.inf
    variance = np.diagonal(tracks.covariance[distance.argmin(axis=1)], axis1=1, axis2=2)
    instants = snapshots(tip, range(BASIS))
    shifts = np.array(list(_shifts(response, instants)))
    return make_basis(instants, shifts, np.sqrt(variance + np.square(floor)).ravel())


def _response(sensor: SensorDesign, tip: Fingertip) -> MarkerResponse:
    return MarkerResponse(sensor, np.stack([sensor.places] * 2), tip.angles())


def _shifts(response: MarkerResponse, instants: Snapshots) -> Iterator[Array]:
    """Shifts of each snapshot, without noise, shape (6M,)."""
    resting = response.measured(np.zeros(instants.displacement.shape[1:]))
    for displacement in instants.displacement:
        yield limited((response.measured(displacement.astype(float)) - resting).ravel())


def _simulate_part(tip: Fingertip, sensor: SensorDesign, basis: Basis, part: _Part) -> int:
    """Write the lessons of some histories; how many these are."""
    rng = np.random.default_rng([78, part.numbers[0]])
    instants = with_mirrored(snapshots(tip, part.numbers))
    shifts = _shifts(_response(sensor, tip), instants)
    lessons = Lessons(
        codes=np.array([_codes(rng, basis, one) for one in shifts]),
        shapes=basis.shapes(instants),
        totals=instants.totals,
        history=instants.history,
    )
    _write(part.file, vars(lessons))
    return len(part.numbers)


def _codes(rng: np.random.Generator, basis: Basis, shifts: Array) -> Array:
    """Codes of shifts (6M,); at some instants a few pairs side by side are lost.

    The likeliest to be lost are pairs that the press moves far, or hides.
    """
    if rng.random() > _LOSING:
        return basis.codes(shifts)
    pairs = shifts.reshape(-1, MEASURED)
    moved = np.linalg.norm(pairs[:, :2], axis=1)
    middle = rng.choice(len(moved), p=moved / moved.sum())
    difference = np.linalg.norm(pairs[:, [0, 1, 3, 4]] - pairs[middle, [0, 1, 3, 4]], axis=1)
    lost = np.argsort(difference)[: rng.integers(1, _MOST_LOST + 1)]
    return basis.codes_without(shifts, (MEASURED * lost[:, None] + np.arange(MEASURED)).ravel())


def _write(path: Path, values: dict[str, Array]) -> None:
    with whole_file(path) as part, part.open("wb") as file:
        np.savez(file, **values)  # type: ignore[arg-type]


def _read(path: Path) -> dict[str, Array]:
    with np.load(path) as file:
        return {name: file[name] for name in file.files}
