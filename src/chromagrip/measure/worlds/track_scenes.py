"""Image sequences with truth on which trackers are scored, from clean to difficult ones.

Conditions describe a sequence, each by a number. Scenes are named conditions; the breakdown curves
vary one condition. Noise is added last. A tracker is given the rest frames, the palette, and the
noise of the camera.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.special import ndtr

from ...render import (
    Defects,
    Flaws,
    Frame,
    Imaging,
    Membrane,
    SensorDesign,
    add_noise,
    centroids,
    decoding_table,
    encode_srgb,
    ground_image,
    inside_rim,
    load_sensor,
    outlines,
    pixel_places,
    rest_membrane,
)
from ...render.drawing import Painter
from ...render.flaws import exposure, white_balance
from ...tracking import Palette
from ..limits.positions import position_limits
from .track_motion import contact_motion, motion

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Number of frames of the untouched sensor.
REST_FRAMES = 8
#: Time between frames [s].
PERIOD = 0.01
#: Radius of the shadow [px].
_SHADOW = 90.0
#: Standard deviation of the shadow's edge, which is 20 px wide from 10 to 90 % [px].
_SHADOW_EDGE = 8.0
#: Half the side of the patch that hides markers [px].
_PATCH = 35.0
#: Grey level of the patch.
_PATCH_LEVEL = 128
#: Markers within this distance of the patch's edge count as partly visible [px].
_MARGIN = 3.0
#: Seed of noise, defects and vanishing markers.
_SEED = 5


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Conditions of a sequence; by default motion and noise alone.

    Attributes
    ----------
    text: one line
    contact: object on the dome of silicone, of `CONTACTS`; empty is the node model's motion
    contact_scale, contact_deeper: factors on its motion after the press, and on the press
    grasp: share of the node model's motion as it is pressed, sheared and released
    sway_px: motion of the whole skin on a closed path, at the apex [px]. The grasp alone moves only
        one marker in ten, and a constant answer would be right about the others.
    shift_pitch: motion from each frame to the next around the apex, out and back [pitches]
    layer_shift_px: of the outer layer over the inner, reached within a quarter of the frames [px]
    drift_pitch: farthest motion of the whole skin with its rim, which turns as well [pitches]
    noise: of the camera, which the tracker is given [grey levels]
    light: share of the light that is left in the last frame, evenly falling
    shading: the same at the right edge, with full light at the left
    shadow: share of the light that a moving shadow with a soft edge takes
    contrast: around level 128, in all frames after rest
    defocus_px: blur in all frames after rest, in addition to the lens [px]
    crosstalk: share of the green that the yellow dye takes, 0 for the sensor's own
    stated_crosstalk: the same as the palette states it, 0 for the true one
    vanishing: share of each layer's markers that are present at rest only
    patch: whether a grey patch moves over the image
    defects: of the camera and the specimen, at rest too
    """

    text: str
    contact: str = ""
    contact_scale: float = 1.0
    contact_deeper: float = 1.0
    grasp: float = 1.0
    sway_px: float = 6.0
    shift_pitch: float = 0.0
    layer_shift_px: float = 0.0
    drift_pitch: float = 0.0
    noise: float = 2.0
    light: float = 1.0
    shading: float = 1.0
    shadow: float = 0.0
    contrast: float = 1.0
    defocus_px: float = 0.0
    crosstalk: float = 0.0
    stated_crosstalk: float = 0.0
    vanishing: float = 0.0
    patch: bool = False
    defects: Defects = field(default_factory=Defects)


SCENES = {
    "clean": Conditions(text="press and shear, nothing else", sway_px=0.0),
    "sway": Conditions(text="the whole skin sways by 6 px too, as in the scenes below"),
    "crosstalk": Conditions(
        text="yellow takes 10 % of the green, as stated; outer layer 3 px over the inner",
        grasp=0.0, sway_px=0.0, layer_shift_px=3.0, crosstalk=0.1,
    ),
    "crosstalk-unknown": Conditions(
        text="the same, but the palette states 1 %",
        grasp=0.0, sway_px=0.0, layer_shift_px=3.0,
        crosstalk=0.1, stated_crosstalk=0.01,
    ),
    "gain-ramp": Conditions(text="light falls from 1 to 0.6", light=0.6),
    "shading-ramp": Conditions(text="light falls from 1 to 0.6 towards the right", shading=0.6),
    "shadow": Conditions(text="a shadow of 30 % with a soft edge moves across", shadow=0.3),
    "contrast": Conditions(text="contrast halved after rest", contrast=0.5),
    "white-balance": Conditions(
        text="red over blue drifts by up to 15 %, exposure jumps by 20 %",
        defects=Defects(
            white_balance_drift=0.15, drift_frames=20, gain_step=0.2, gain_step_frames=10
        ),
    ),
    "noise": Conditions(text="noise of 6 grey levels", noise=6.0),
    "blur": Conditions(text="1 px more defocus than at rest", defocus_px=1.0),
    "jpeg": Conditions(text="JPEG of quality 75", defects=Defects(jpeg_quality=75)),
    "h264": Conditions(text="H.264 at rate factor 23", defects=Defects(h264_crf=23)),
    "bayer": Conditions(text="one colour per pixel, interpolated", defects=Defects(bayer=True)),
    "specular-dust": Conditions(
        text="4 mirrored LEDs and 25 specks of dust", defects=Defects(specular=4, dust=25)
    ),
    "missing": Conditions(
        text="5 % of each layer's markers missing from the start, 5 % vanish after rest",
        vanishing=0.05, defects=Defects(missing_markers=0.05),
    ),
    "occlusion": Conditions(text="a grey patch moves over the markers", patch=True),
    "jump": Conditions(
        text="1.2 pitches from frame to frame, 5 % of each layer's markers vanished",
        grasp=0.0, sway_px=0.0, shift_pitch=1.2, vanishing=0.05,
    ),
    "drift": Conditions(
        text="the whole skin drifts to three pitches from rest, in all directions, and turns",
        grasp=0.0, sway_px=0.0, drift_pitch=3.0,
    ),
    "twist": Conditions(text="a ball pressed on the dome and turned by 40°", contact="twist"),
    "edge": Conditions(text="an edge pressed on the dome and dragged askew", contact="edge"),
    "two-contacts": Conditions(
        text="two balls pressed on the dome and dragged", contact="two-contacts"
    ),
    "roll": Conditions(text="a rod of 7 mm rolled over the dome", contact="roll"),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One frame and its truth; NaN where an absent marker has none.

    Attributes
    ----------
    frame: image that the tracker is given
    centre: of each marker's image, present or not [px], shape (2, M, 2)
    visible: whether all of it is visible, shape (2, M)
    hidden: whether nothing of it is visible, shape (2, M)
    limit: Cramér–Rao bound of the standard deviation of (x, y) [px], shape (2, M, 2)
    hue: of the mean noise-free colour inside each outer marker's outline [°], shape (M,)
    height: displacement along the skin's normal, outwards [m], shape (2, M)
    """

    frame: Frame
    centre: Array
    visible: NDArray[np.bool_]
    hidden: NDArray[np.bool_]
    limit: Array
    hue: Array
    height: Array


@dataclass(frozen=True, kw_only=True)
class Sequence:
    """Frames of a sensor at rest and of its motion, with their truth.

    Attributes
    ----------
    palette: description of the markers that trackers are given
    noise: of the camera [grey levels]
    rest: frames of the untouched sensor
    centre: of the markers' images at rest [px], shape (2, M, 2)
    there: whether a marker is present at rest, shape (2, M)
    distance: of the markers from the sphere's centre at rest [m], shape (2, M)
    radius: of a typical marker's image in each layer [px], shape (2,)
    shots: frames with their truth
    """

    palette: Palette
    noise: float
    rest: list[Frame]
    centre: Array
    there: NDArray[np.bool_]
    distance: Array
    radius: Array
    shots: list[Shot]


def sequence(c: Conditions, count: int, *, limits: bool = True) -> Sequence:
    """Frames of a sequence with their truth; the same conditions give the same bytes.

    Parameters
    ----------
    c: conditions
    count: frames after rest
    limits: whether to compute the Cramér–Rao bounds, else they are NaN
    """
    sensor, stated = _sensors(c)
    painter, imaging = _painter(sensor), Imaging(sensor, c.defects, _SEED)
    flaws = Flaws(sensor, c.defects, _SEED)
    absent = flaws.missing  # absent markers have a place too
    rest = rest_membrane(sensor, flaws.places)
    at_rest = imaging.measured(painter.render(_without(rest, absent)), 0)
    gone = absent | _vanished(absent, c.vanishing)
    shots = []
    path = _path(c, sensor, flaws.places, count)
    for k, moved in enumerate(path):
        membrane = _without(moved, gone)
        light = _light(c, k, count, sensor)
        clean = _expose(painter.render(membrane), light, c)
        patch = _patch_place(k, count) if c.patch else None
        _cover(clean, patch)
        centre = _centres(sensor, moved)
        covered, partly = _behind(centre, _radius(sensor), patch)
        if c.drift_pitch:
            covered, partly = _beyond_rim(sensor, centre)
        limit = _limits(c, k, sensor, membrane, light) if limits else np.full_like(centre, np.nan)
        image = imaging.measured(clean, k)
        hue = _hues(image, outlines(membrane, sensor.view)[0])
        add_noise(image, c.noise, _SEED, k)
        shots.append(
            Shot(
                frame=Frame(image=imaging.compressed(image), time=PERIOD * (k + 1)),
                centre=centre,
                visible=~(gone | partly | covered),
                hidden=gone | covered,
                limit=limit,
                hue=hue,
                height=_distance(moved) - _distance(rest),
            )
        )
    return Sequence(
        palette=Palette.of_sensor(stated),
        noise=c.noise,
        rest=_rest_frames(imaging, at_rest, c.noise),
        centre=_centres(sensor, rest),
        there=~absent,
        distance=_distance(rest),
        radius=_radius(sensor),
        shots=shots,
    )


def _path(
    c: Conditions, sensor: SensorDesign, places: Array | None, count: int
) -> Iterator[Membrane]:
    """Membranes of so many frames."""
    if c.contact:
        factors = c.contact_scale, c.contact_deeper
        return contact_motion(sensor, places, count, c.contact, *factors)
    return motion(
        sensor,
        places,
        count,
        grasp=c.grasp,
        sway_px=c.sway_px,
        shift_pitch=c.shift_pitch,
        layer_shift_px=c.layer_shift_px,
        drift_pitch=c.drift_pitch,
    )


def _limits(c: Conditions, k: int, sensor: SensorDesign, membrane: Membrane, light: Array) -> Array:
    """Cramér–Rao bounds of the markers of a frame [px], shape (2, M, 2)."""
    ground = _ground(sensor) * (light[..., None] * _camera_gain(c.defects, k))
    return position_limits(
        sensor, membrane, ground, c.noise, defocus=c.defocus_px, contrast=c.contrast
    )


def _rest_frames(imaging: Imaging, measured: Image, noise: float) -> list[Frame]:
    """Frames of the unloaded sensor, each with noise of its own."""
    noises = (noisy(measured, noise, 2**31 + k, 0.0) for k in range(REST_FRAMES))
    return [Frame(image=imaging.compressed(frame.image), time=frame.time) for frame in noises]


def noisy(clean: Image, noise: float, index: int, time: float) -> Frame:
    """Frame of a picture with the noise of that index."""
    image = clean.copy()
    add_noise(image, noise, _SEED, index)
    return Frame(image=image, time=time)


def _sensors(c: Conditions) -> tuple[SensorDesign, SensorDesign]:
    """The sensor as it is, and as its palette states it."""
    sensor = load_sensor("thesis")
    true = c.crosstalk
    return _with_crosstalk(sensor, true), _with_crosstalk(sensor, c.stated_crosstalk or true)


def _with_crosstalk(sensor: SensorDesign, share: float) -> SensorDesign:
    if not share:
        return sensor
    red, _, blue = sensor.inner.transmittance
    return replace(sensor, yellow=replace(sensor.inner, transmittance=(red, 1.0 - share, blue)))


def _vanished(missing: NDArray[np.bool_], share: float) -> NDArray[np.bool_]:
    """Markers that are present at rest and absent afterwards, shape (2, M)."""
    gone = np.zeros_like(missing)
    rng = np.random.default_rng([_SEED, 17])
    for layer in range(2):
        there = np.flatnonzero(~missing[layer])
        gone[layer, rng.permutation(there)[: round(share * len(there))]] = True
    return gone


def _without(membrane: Membrane, gone: NDArray[np.bool_]) -> Membrane:
    centres = np.where(gone[..., None], np.nan, membrane.centres)
    return Membrane(centres=centres, axes=membrane.axes)


def _centres(sensor: SensorDesign, membrane: Membrane) -> Array:
    return centroids(outlines(membrane, sensor.view), square=False)


def _distance(membrane: Membrane) -> Array:
    return np.asarray(np.linalg.norm(membrane.centres, axis=-1))


@lru_cache(maxsize=4)
def _painter(sensor: SensorDesign) -> Painter:
    return Painter(sensor)


@lru_cache(maxsize=4)
def _ground(sensor: SensorDesign) -> Array:
    """Linear light without markers, shape (H, W, 3)."""
    return ground_image(sensor).astype(float)


@lru_cache(maxsize=4)
def _radius(sensor: SensorDesign) -> Array:
    axes = outlines(rest_membrane(sensor), sensor.view)[:, :, 1:3]
    area = abs(np.linalg.det(axes))
    return np.sqrt(np.median(area, axis=1))


def _light(c: Conditions, k: int, count: int, sensor: SensorDesign) -> Array:
    """Share of the light that is left at each pixel of a frame, shape (H, W)."""
    height, width = sensor.view.height, sensor.view.width
    share = (k + 1) / count
    x, y = np.arange(width)[None, :], np.arange(height)[:, None]
    light = np.full((height, width), 1.0 - share * (1.0 - c.light))
    light *= 1.0 - share * (1.0 - c.shading) * x / (width - 1)
    if c.shadow:
        away = np.hypot(x - width * (0.15 + 0.7 * share), y - 0.45 * height)
        light *= 1.0 - c.shadow * ndtr((_SHADOW - away) / _SHADOW_EDGE)
    return light


def _expose(image: Image, light: Array, c: Conditions) -> Image:
    """Picture in other light, out of focus and of another contrast, noise-free."""
    if c.light == c.shading == c.contrast == 1.0 and not (c.shadow or c.defocus_px):
        return image
    linear = decoding_table()[image] * light[..., None]
    if c.defocus_px:
        linear = np.asarray(cv2.GaussianBlur(linear, (0, 0), c.defocus_px))
    levels = 128.0 + c.contrast * (encode_srgb(linear) - 128.0)
    return np.rint(levels).astype(np.uint8)


def _camera_gain(defects: Defects, k: int) -> Array:
    """Gains of (R, G, B) by exposure and white balance in a frame, shape (3,)."""
    red, blue = white_balance(defects, _SEED, k)
    return exposure(defects, _SEED, k) * np.array([red, 1.0, blue])


def _patch_place(k: int, count: int) -> Array:
    """Middle of the patch [px]: once around the image's middle."""
    angle = 2 * np.pi * k / count
    return np.array([319.5 + 110.0 * np.cos(angle), 239.5 + 110.0 * np.sin(angle)])


def _cover(image: Image, patch: Array | None) -> None:
    if patch is not None:
        (left, top), (right, bottom) = (np.rint(patch + s * _PATCH).astype(int) for s in (-1, 1))
        image[top : bottom + 1, left : right + 1] = _PATCH_LEVEL


def _behind(centre: Array, radius: Array, patch: Array | None) -> tuple[NDArray[np.bool_], ...]:
    """Whether markers are completely and whether they are partly hidden, shape (2, M) each."""
    if patch is None:
        none = np.zeros(centre.shape[:2], dtype=np.bool_)
        return none, none
    away = abs(centre - patch).max(axis=-1) - _PATCH
    reach = radius[:, None] + _MARGIN
    return away < -reach, abs(away) <= reach


def _beyond_rim(sensor: SensorDesign, centre: Array) -> tuple[NDArray[np.bool_], ...]:
    """Whether the rim or the picture's edge hides markers completely, and partly, (2, M) each."""
    inside, (height, width) = _inside(sensor), (sensor.view.height, sensor.view.width)
    x, y = np.moveaxis(np.rint(centre).astype(int), -1, 0)
    rim = inside[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    edge = (np.array([width, height]) / 2 - abs(centre - [width / 2, height / 2])).min(axis=-1)
    away, reach = np.minimum(rim, edge), _radius(sensor)[:, None] + _MARGIN
    return away < -reach, abs(away) <= reach


@lru_cache(maxsize=4)
def _inside(sensor: SensorDesign) -> Array:
    """Distance from the rim in the picture, positive inside [px], shape (H, W)."""
    return inside_rim(sensor, pixel_places(sensor))


def _hues(image: Image, coefficients: Array) -> Array:
    """Hue [°] of the mean colour inside outlines (M, 6, 2) of a picture, shape (M,)."""
    line = np.linspace(-1.0, 1.0, 17)
    q = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    q = q[(q**2).sum(axis=-1) < 1.0]
    points = coefficients[:, :1] + q @ coefficients[:, 1:3]
    x, y = np.moveaxis(points.astype(np.float32), -1, 0)
    colours = cv2.remap(image.astype(np.float32), x, y, cv2.INTER_LINEAR)
    red, green, blue = np.moveaxis(np.asarray(colours, dtype=float).mean(axis=1), -1, 0)
    hue = np.degrees(np.arctan2(np.sqrt(3.0) * (green - blue), 2.0 * red - green - blue))
    return np.where(np.isfinite(coefficients[:, 0, 0]), hue, np.nan)
