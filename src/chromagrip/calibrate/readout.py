"""From a sensor's calibration to its read-out: histories, pictures' shifts, codes, networks."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..loop.camera import SimulatedCamera
from ..model import Fingertip, rest_state
from ..render import SensorDesign, open_renderer
from ..tracking import MarkerTracker, Palette, SensorCalibration
from ..tracking.forces.chain.readout import limited, save_readout
from ..tracking.forces.chain.sensitivity import MarkerResponse
from ..tracking.forces.shifts import MEASURED
from .histories import Snapshots, snapshots, with_mirrored
from .networks import Basis, Lessons, fit_readout, make_basis

Array = NDArray[np.float64]

#: Histories of a part: what is lost at most by an interruption. And of the basis.
PART, BASIS = 250, 500
#: Share of the instants at which pairs are lost, and how many at most.
_LOSING, _MOST_LOST = 0.3, 5
#: Frames at rest from which the noise of the shifts is found.
_FRAMES = 8


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

    What is done stays in `out`.parts until all is done, so that an interrupted training goes on
    where it was.

    Parameters
    ----------
    calibration: of the sensor
    noise: of its camera [grey levels]
    histories: to learn from
    epochs: passes over them
    out: file of the read-out
    workers: processes
    tell: is called with what is being done
    """
    parts = out.with_name(out.name + ".parts")
    tip, sensor = calibration.fingertip, calibration.sensor
    tell("the noise of a frame")
    first = parts / "basis.npz"
    if not first.exists():
        found = _basis(calibration, noise)
        parts.mkdir(exist_ok=True)
        _write(first, vars(found))
    basis = Basis(**_read(first))
    files = {
        parts / f"{first}-{PART}.npz": range(first, min(first + PART, histories))
        for first in range(0, histories, PART)
    }
    wanted = {file: numbers for file, numbers in files.items() if not file.exists()}
    done = histories - sum(map(len, wanted.values()))
    context = get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_one_thread) as pool:
        jobs = [
            pool.submit(_part, numbers, tip, sensor, basis, file)
            for file, numbers in wanted.items()
        ]
        try:
            for job in as_completed(jobs):
                done += job.result()
                tell(f"histories, {done} of {histories}")
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    taught = [_read(file) for file in files]
    lessons = Lessons(**{key: np.concatenate([t[key] for t in taught]) for key in taught[0]})
    readout, errors = fit_readout(tip, sensor, basis, lessons, epochs, tell)
    save_readout(readout, out)
    for file in parts.iterdir():
        file.unlink()
    parts.rmdir()
    return errors


def _basis(calibration: SensorCalibration, noise: float) -> Basis:
    sensor, tip = calibration.sensor, calibration.fingertip
    response = _response(sensor, tip)  # first, for what it refuses
    camera = SimulatedCamera(sensor, open_renderer("painter", sensor), tip.nodes, noise, seed=0)
    tracker = MarkerTracker(Palette.of_sensor(sensor), noise)
    state = rest_state(tip)
    tracker.reset(camera.expose_rest(state, _FRAMES))
    tracks = tracker.update(camera.expose(state, 0))
    camera.close()
    floor = [calibration.position_floor, calibration.position_floor, calibration.size_floor] * 2
    # Variances of the design's pairs, each that of the pair that was found nearest to it.
    places = sensor.view.project(sensor.shape.points(sensor.places, sensor.depths[0]))
    apart = np.linalg.norm(places[:, None] - tracks.position[0], axis=-1)
    apart[:, ~tracks.visible.all(axis=0)] = np.inf
    variance = np.diagonal(tracks.covariance[apart.argmin(axis=1)], axis1=1, axis2=2)
    seen = snapshots(tip, range(BASIS))
    shifts = np.array(list(_shifts(response, seen)))
    return make_basis(seen, shifts, np.sqrt(variance + np.square(floor)).ravel())


def _response(sensor: SensorDesign, tip: Fingertip) -> MarkerResponse:
    return MarkerResponse(sensor, np.stack([sensor.places] * 2), tip.angles())


def _shifts(response: MarkerResponse, seen: Snapshots) -> Iterator[Array]:
    """Shifts of each snapshot, without noise, shape (6M,)."""
    resting = response.measured(np.zeros(seen.seen.shape[1:]))
    for moved in seen.seen:
        yield limited((response.measured(moved.astype(float)) - resting).ravel())


def _part(numbers: range, tip: Fingertip, sensor: SensorDesign, basis: Basis, file: Path) -> int:
    rng = np.random.default_rng([78, numbers[0]])
    seen = with_mirrored(snapshots(tip, numbers))
    codes = np.array(
        [_codes(rng, basis, shifts) for shifts in _shifts(_response(sensor, tip), seen)]
    )
    lessons = Lessons(
        codes=codes, shapes=basis.shapes(seen), totals=seen.totals, history=seen.history
    )
    _write(file, vars(lessons))
    return len(numbers)


def _codes(rng: np.random.Generator, basis: Basis, shifts: Array) -> Array:
    """Codes of shifts (6M,); now and then some pairs side by side are lost.

    Those are lost that the press moves much, or hides.
    """
    if rng.random() > _LOSING:
        return basis.codes(shifts)
    pairs = shifts.reshape(-1, MEASURED)
    moved = np.linalg.norm(pairs[:, :2], axis=1)
    middle = rng.choice(len(moved), p=moved / moved.sum())
    alike = np.linalg.norm(pairs[:, [0, 1, 3, 4]] - pairs[middle, [0, 1, 3, 4]], axis=1)
    lost = np.argsort(alike)[: rng.integers(1, _MOST_LOST + 1)]
    return basis.codes_without(shifts, (MEASURED * lost[:, None] + np.arange(MEASURED)).ravel())


def _write(path: Path, values: dict[str, Array]) -> None:
    part = path.with_suffix(".part")
    with part.open("wb") as file:
        np.savez(file, **values)  # type: ignore[arg-type]
    os.replace(part, path)


def _read(path: Path) -> dict[str, Array]:
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def _one_thread() -> None:
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)
