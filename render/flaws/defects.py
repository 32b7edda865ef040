"""Defects of a real sensor as dials, and those of its markers."""

from dataclasses import replace
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from ...strict_toml import Table
from ..design.sensor import SensorDesign, Share
from ..membrane import Membrane

Array = NDArray[np.float64]

Electrons = Annotated[float, Meta(ge=0.0, le=1e6)]
Blur = Annotated[float, Meta(ge=0.0, le=20.0)]
Half = Annotated[float, Meta(ge=0.0, le=0.5)]
Frames = Annotated[int, Meta(ge=1, le=10**6)]
Offset = Annotated[float, Meta(ge=0.0, le=2.0)]

# Numbers of random streams, one for each defect, so that no dial changes another one's draws. They
# stand last in a seed and start at 1: NumPy ignores trailing zeros of a seed.
LEDS = 1
DUST = 2
SPECULAR = 3
NOISE = 4
WHITE_BALANCE = 5
GAIN = 6
MISSING = 7
MISALIGNMENT = 8
MISPLACEMENT = 9
WORN = 10


class Defects(Table, frozen=True):
    """Defects of a real sensor's images, each with a dial; all are off by default.

    There is no dial for faded markers, because a renderer has one dye per layer.

    Attributes
    ----------
    shot_noise_electrons: full well, the electrons of linear light 1; fewer are noisier, 0 is off
    read_noise_electrons: standard deviation, of the full well above or of 10 000 [electrons]
    vignette: share of light lost in the image's farthest corner; grows with the square of distance
    uneven_leds: largest deviation of the skin's illumination from its mean
    defocus_px: standard deviation of a blur on top of the lens' own [px]
    motion_blur: share of the frame's period that the shutter is open
    white_balance_drift: largest deviation of red over blue from its mean
    drift_frames: in which the white balance wanders from one value to the next [frames]
    gain_step: relative size of exposure jumps, up and down in turn around the nominal exposure
    gain_step_frames: mean time between jumps [frames]
    bayer: whether each pixel measures one colour, RGGB, and the others are interpolated
    jpeg_quality: 1…100 as in libjpeg, in 4:2:2 as cameras send it; 0 is off
    h264_crf: 1…51 as in x264, in 4:2:0, each frame by itself; 0 is off
    dust: number of specks on the skin's image
    specular: number of LEDs that the silicone mirrors
    missing_markers: share of each layer's markers that are not there
    worn_markers: share of the outer layer's markers that are rubbed off, around the middle, where
        the sensor touches: a patch with a ragged edge
    seam_tint: strength of the gores' tinted seams, the design's or else four
    misalignment_mm: shift of the yellow layer along the skin, and a turn of up to that at the rim
    misplacement_mm: standard deviation of each marker's place, along each direction of the skin
    """

    shot_noise_electrons: Electrons = 0.0
    read_noise_electrons: Electrons = 0.0
    vignette: Share = 0.0
    uneven_leds: Share = 0.0
    defocus_px: Blur = 0.0
    motion_blur: Share = 0.0
    white_balance_drift: Half = 0.0
    drift_frames: Frames = 500
    gain_step: Share = 0.0
    gain_step_frames: Frames = 200
    bayer: bool = False
    jpeg_quality: Annotated[int, Meta(ge=0, le=100)] = 0
    h264_crf: Annotated[int, Meta(ge=0, le=51)] = 0
    dust: Annotated[int, Meta(ge=0, le=1000)] = 0
    specular: Annotated[int, Meta(ge=0, le=100)] = 0
    missing_markers: Share = 0.0
    worn_markers: Share = 0.0
    seam_tint: Share = 0.0
    misalignment_mm: Offset = 0.0
    misplacement_mm: Offset = 0.0


class Flaws:
    """Defects of the markers of one specimen: misplaced along the skin, or missing.

    Parameters
    ----------
    sensor: design
    defects: their sizes
    seed: of the run; one seed is one specimen

    Attributes
    ----------
    places: of the markers of each layer, see `skin`, shape (2, M, 2); None is as designed
    missing: whether a marker is missing, shape (2, M)
    """

    def __init__(self, sensor: SensorDesign, defects: Defects, seed: int) -> None:
        count = len(sensor.places)
        self.places: Array | None = None
        if defects.misplacement_mm or defects.misalignment_mm:
            self.places = _misplaced(sensor, defects, seed)
        self.missing = np.zeros((2, count), dtype=np.bool_)
        absent = round(defects.missing_markers * count)
        for layer in range(2):
            order = np.random.default_rng([seed, layer, MISSING]).permutation(count)
            self.missing[layer, order[:absent]] = True
        # Half as far from the middle, or half as far again: the edge is ragged.
        ragged = np.random.default_rng([seed, WORN]).uniform(0.5, 1.5, count)
        nearest = np.argsort(sensor.places[:, 0] * ragged, kind="stable")
        outer = int(np.argmin(sensor.depths))
        self.missing[outer, nearest[: round(defects.worn_markers * count)]] = True

    def __call__(self, membrane: Membrane) -> Membrane:
        """Membrane without the missing markers, whose centres are NaN."""
        if not self.missing.any():
            return membrane
        centres = membrane.centres.copy()
        centres[self.missing] = np.nan
        return replace(membrane, centres=centres)


def _misplaced(sensor: SensorDesign, defects: Defects, seed: int) -> Array:
    """Places of each layer's markers, shape (2, M, 2)."""
    skin, count = sensor.shape, len(sensor.places)
    points = np.stack([skin.points(sensor.places, depth) for depth in sensor.depths])
    moved = np.zeros_like(points)
    scatter = np.random.default_rng([seed, MISPLACEMENT]).standard_normal((2, count, 2))
    along = np.stack(skin.tangents(sensor.places), axis=-1)
    moved += 1e-3 * defects.misplacement_mm * np.einsum("mki,lmi->lmk", along, scatter)
    moved[1] += misalignment(sensor, points[1], defects.misalignment_mm * 1e-3, seed)
    return np.stack([skin.places_of(p) for p in points + moved])


def misalignment(sensor: SensorDesign, points: Array, size: float, seed: int) -> Array:
    """Displacement of points of a layer that lies beside its place on the skin [m], (…, 3).

    Parameters
    ----------
    sensor: design
    points: of the resting layer [m], shape (…, 3)
    size: shift of its middle; the turn about the axis moves the rim by up to as much [m]
    seed: of the direction and the turn
    """
    rng = np.random.default_rng([seed, MISALIGNMENT])
    angle, turn = rng.uniform(0.0, 2 * np.pi), rng.uniform(-1.0, 1.0)
    x, y = np.cos(angle), np.sin(angle)
    if sensor.shape.flat:
        axis = np.array([0.0, 0.0, turn / sensor.shape.half])
        return size * (np.array([x, y, 0.0]) + np.cross(axis, points))
    # On a ball every shift is a turn.
    axis = np.array([-y, x, turn]) / np.linalg.norm(points, axis=-1).max()
    return size * np.cross(axis, points)
