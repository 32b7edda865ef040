"""Grasps whose object, or whose grip and load over time, is of another kind than the library's.

Each function draws one: `draw(rng, low, high)` has a margin of about low to high where that can be
chosen.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ....model import ContactObject, Drive
from ..force_scenes import Grasp
from ..grasps import LIBRARY_RANGES, NORMALS, Ranges, random_grasp

Array = NDArray[np.float64]

#: Draws a grasp with a margin between two bounds.
Draw = Callable[[np.random.Generator, float, float], Grasp]

#: Instants after a change of grip or load at which forces are read [s], and their names.
AFTER = {"after-0.1s": 0.1, "after-0.3s": 0.3, "after-0.8s": 0.8}
#: Length of a bump's outline on either side [m], and its points.
_REACH, _POINTS = 6e-3, 121
#: Grips that leave room for more.
_LIGHT = Ranges(normals=(NORMALS[0], 3.0))


def drawn_from(ranges: Ranges) -> Draw:
    """Grasps of the library with other ranges."""
    return lambda rng, low, high: random_grasp(rng, low, high, ranges)


def with_law(stiffness: float, exponent: float, drag: float) -> Draw:
    """Grasps of the library with another friction law.

    Parameters
    ----------
    stiffness: σ0 [N/m]
    exponent: n
    drag: of the object [N·s/m]
    """
    changes = {"dahl_stiffness": stiffness, "dahl_exponent": exponent, "drag": drag}
    return lambda rng, low, high: _changed(random_grasp(rng, low, high), **changes)


def tilted_plane(rng: np.random.Generator, low: float, high: float) -> Grasp:
    """A plane tilted by 1.9° to 10°, either way; it slips under the grip alone where µ is small."""
    slope = np.tan(np.deg2rad(rng.uniform(1.9, 10.0))) * rng.choice([-1.0, 1.0])
    x = np.linspace(-_REACH, _REACH, 5)
    return _profiled(rng, low, high, x, slope * x)


def bump(rng: np.random.Generator, low: float, high: float) -> Grasp:
    """A flat object with a bump of .1 to .5 mm somewhere on it."""
    height, width = rng.uniform(0.1e-3, 0.5e-3), rng.uniform(0.5e-3, 1.5e-3)
    place = rng.uniform(-2e-3, 2e-3)
    x = np.linspace(-_REACH, _REACH, _POINTS)
    return _profiled(rng, low, high, x, -height * np.exp(-0.5 * ((x - place) / width) ** 2))


def two_bumps(rng: np.random.Generator, low: float, high: float) -> Grasp:
    """Two round ridges, at ±2.2 mm or elsewhere, so high that the middle touches nothing."""
    apart = 2.2e-3 if rng.random() < 0.5 else rng.uniform(1.6e-3, 3e-3)
    height, width = rng.uniform(0.8e-3, 1.4e-3), rng.uniform(0.6e-3, 0.9e-3)
    x = np.linspace(-_REACH, _REACH, _POINTS)
    ridges = [np.exp(-0.5 * ((x - side * apart) / width) ** 2) for side in (-1.0, 1.0)]
    return _profiled(rng, low, high, x, -height * (ridges[0] + ridges[1]), _LIGHT)


def patched(rng: np.random.Generator, low: float, high: float) -> Grasp:
    """An object whose µ varies over its surface by up to a factor of 2.5, over 1 to 3 mm."""
    grasped = random_grasp(rng, low, high)
    x = np.cumsum(rng.uniform(1e-3, 3e-3, 5))
    x -= x.mean()
    factors = np.exp(rng.uniform(np.log(0.6), np.log(1.5), 5))
    patches = tuple((float(a), float(b)) for a, b in zip(x, factors, strict=True))
    return _changed(grasped, patches=patches)


def sliding(rng: np.random.Generator, low: float, high: float) -> Grasp:
    """A grasp whose load is above what friction can hold for its last .2 to .8 s."""
    grasped = random_grasp(rng, 0.1, 0.4)
    end = grasped.ends[-1]
    begin = end + 0.1
    end = begin + rng.uniform(0.2, 0.8)
    grip = grasped.drive.normal[-1]
    side = np.sign(grasped.drive.lateral[-1])
    load = side * (1.0 + rng.uniform(0.05, 0.4)) * grasped.obj.friction * grip
    return _continued(grasped, [begin, begin + 0.05, end], [grip] * 3, [None, load, load])


def trembling(rng: np.random.Generator, low: float, high: float) -> Grasp:
    """A held grasp whose grip trembles by 3 to 12 % at 5 to 12 Hz, and its load half as much."""
    grasped = random_grasp(rng, low, high)
    drive = grasped.drive
    time = np.linspace(0.0, grasped.ends[-1], 751)
    rate, size = 2.0 * np.pi * rng.uniform(5.0, 12.0), rng.uniform(0.03, 0.12)
    on = np.clip(time / 0.3, 0.0, 1.0)
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    grip, load = (
        size * share * on * np.sin(rate * time + phase)
        for share, phase in zip((1.0, 0.5), phases, strict=True)
    )
    normal, lateral = drive.at(time).T
    shaken = Drive(times=time, normal=normal * (1.0 + grip), lateral=lateral * (1.0 + load))
    return replace(grasped, drive=shaken)


def grip_step(rng: np.random.Generator, low: float, high: float) -> Grasp:
    """A step of the grip by a factor of 1.2 to 2.5 under a standing load."""
    before = rng.uniform(0.03, 0.5)
    grasped = random_grasp(rng, before, before + 0.02, _LIGHT)
    grip = rng.uniform(1.2, 2.5) * grasped.drive.normal[-1]
    return _after(grasped, grip, float(grasped.drive.lateral[-1]))


def load_step(rng: np.random.Generator, low: float, high: float) -> Grasp:
    """A step of the load to the margin, up or down, under a standing grip."""
    grasped = random_grasp(rng, 0.1, 0.95)
    grip = float(grasped.drive.normal[-1])
    side = np.sign(grasped.drive.lateral[-1]) or 1.0
    load = side * (1.0 - rng.uniform(low, high)) * grasped.obj.friction * grip
    return _after(grasped, grip, load)


def _after(grasped: Grasp, grip: float, load: float) -> Grasp:
    """Grasp that goes on with another grip and load at once."""
    begin = grasped.ends[-1]
    end = begin + max(AFTER.values())
    more = _continued(grasped, [begin, end], [grip] * 2, [load] * 2)
    ends = tuple(begin + passed for passed in AFTER.values())
    return replace(more, ends=ends, named=tuple(AFTER))


def _continued(
    grasped: Grasp, times: list[float], normal: list[float], lateral: list[float | None]
) -> Grasp:
    """Grasp with more points of its drive; None is the load that it has."""
    # A whole number of frames.
    times = [round(time, 2) for time in times]
    drive = grasped.drive
    held = float(drive.lateral[-1])
    longer = Drive(
        times=np.append(drive.times, times),
        normal=np.append(drive.normal, normal),
        lateral=np.append(drive.lateral, [held if load is None else load for load in lateral]),
    )
    return replace(grasped, drive=longer, ends=(times[-1],))


def _profiled(
    rng: np.random.Generator,
    low: float,
    high: float,
    x: Array,
    z: Array,
    ranges: Ranges = LIBRARY_RANGES,
) -> Grasp:
    profile = tuple((float(a), float(b)) for a, b in zip(x, z, strict=True))
    return _changed(random_grasp(rng, low, high, ranges), curvature=0.0, profile=profile)


def _changed(grasped: Grasp, **changes: object) -> Grasp:
    obj: ContactObject = replace(grasped.obj, **changes)  # type: ignore[arg-type]
    return replace(grasped, obj=obj)
