"""Presses of domes of Neo-Hookean silicone, by finite elements: no linear dome made their pictures.

`elements.npz` holds them; `fixtures/hyperelastic/watched.py` makes it and says what it is. The
object sticks where it touches, or slips on it without friction. Both are pressed without a load.
"""

from contextlib import closing
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ....model import Motion, Solid
from ....model.dome import resting
from ....model.shapes import plane
from ....output.processes import one_thread
from ....tracking import sensor_as_designed
from ..force_scenes import NOISE, REST_FRAMES, tracked
from .scenes import PERIOD, SEED, Watched
from .specimens import Specimen, matched

Array = NDArray[np.float64]

PRESSES = Path(__file__).parent / "elements.npz"
#: Normal forces that are read, one after another [N], and frames to press to each and to hold it.
NORMALS, _PRESSING, _HOLDING = (1.0, 2.0, 3.0), 12, 4
#: Objects, and how they touch.
CASES = tuple(f"{thing} {how}" for thing in ("plane", "ball") for how in ("sticks", "slips"))


class ElementField:
    """Motion of markers in a press that finite elements have solved.

    Parameters
    ----------
    name: of the design
    case: of CASES
    specimen: whose Young's modulus scales the forces
    """

    def __init__(self, name: str, case: str, specimen: Specimen) -> None:
        book = presses()
        self._normal = specimen.dome.young * book[f"{name} {case}/normal"]
        self._moved = book[f"{name} {case}/moved"].astype(np.float64)
        self._angles = book["angles"]
        self._metric = specimen.dome.radius - np.minimum(
            specimen.sensor.depths, specimen.dome.thickness
        )

    def __call__(self, places: Array, normal: float) -> tuple[Array, Array]:
        """Displacement (2, M, 3) [m] and slopes (2, M, 3, 2) of markers at a normal force [N].

        Parameters
        ----------
        places: angle from the apex and azimuth of the markers [rad], shape (2, M, 2)
        normal: sum of the normal forces [N]
        """
        step = np.interp(normal, self._normal, np.arange(len(self._normal)))
        low = min(int(step), len(self._normal) - 2)
        both = self._moved[low] + (step - low) * (self._moved[low + 1] - self._moved[low])
        parts = [
            _turned(CubicSpline(self._angles, each, axis=0), at, length)
            for each, at, length in zip(both, places, self._metric, strict=True)
        ]
        return np.stack([moved for moved, _ in parts]), np.stack([slope for _, slope in parts])


def _turned(spline: CubicSpline, places: Array, length: float) -> tuple[Array, Array]:
    """Motion along and away from the axis, at places all around it."""
    angle, azimuth = np.maximum(places[:, 0], 1e-6), places[:, 1]
    (up, out), (up_slope, out_slope) = spline(angle).T, spline(angle, 1).T
    cos, sin, zero = np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)
    moved = np.stack([out * cos, out * sin, up], axis=-1)
    along = np.stack([out_slope * cos, out_slope * sin, up_slope], axis=-1)
    around = (out / np.sin(angle))[:, None] * np.stack([-sin, cos, zero], axis=-1)
    return moved, np.stack([along, around], axis=-1) / length


@lru_cache(maxsize=1)
def presses() -> dict[str, Array]:
    """Everything in PRESSES."""
    with np.load(PRESSES) as book:
        return {name: book[name] for name in book.files}


def pressed_scene(name: str, index: int) -> Watched:
    """A press of a design; cases take turns. The same arguments give the same bytes."""
    case, specimen = CASES[index % len(CASES)], matched(name)
    motion = Motion(times=np.array([0.0, 1.0]), poses=np.zeros((2, 6)))
    start = resting(specimen.dome, Solid(shape=plane()), motion)
    field = ElementField(name, case, specimen)
    # A state carries the normal force in place of the forces on the nodes.
    levels = [0.0]
    for normal in NORMALS:
        levels += list(np.linspace(levels[-1], normal, _PRESSING + 1)[1:]) + [normal] * _HOLDING
    states = [
        replace(start, time=k * PERIOD, linear=np.full_like(start.linear, level))
        for k, level in enumerate(levels)
    ]
    with one_thread():
        camera = specimen.camera(
            SEED + index, lambda places, carried: field(places, float(carried[0, 0]))
        )
        with closing(camera):
            rest = camera.expose_rest(states[0], REST_FRAMES)
            frames = {k: camera.expose(state, k) for k, state in enumerate(states)}
        known = sensor_as_designed(name)
        at_rest, tracks = tracked(known, NOISE, rest, frames)
    return Watched(
        known=known,
        rest=at_rest,
        tracks=list(tracks.values()),
        scored=tuple((k + 1) * (_PRESSING + _HOLDING) for k in range(len(NORMALS))),
        true=np.array([[normal, 0.0, np.nan, 1.0] for normal in NORMALS]),
        side=np.zeros((len(NORMALS), 3)),
        label=case,
    )
