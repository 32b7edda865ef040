"""Several tactile sensors in step: poses of all objects in; a stack of the sensors' arrays out.

    sensors = [chromagrip.TactileSensor("dome-2020", noise=2.0, seed=k) for k in range(16)]
    for sensor in sensors:
        sensor.attach(Solid(shape=shapes.mesh("mug.obj"), friction=0.6))
    failed = chromagrip.update_all(sensors, object_pos, object_quat, dt=1 / 60)
    chromagrip.stacked(sensors, "image"), chromagrip.stacked(sensors, "wrench")

Each sensor has the bytes that it has alone.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from ..errors import UserError, located
from ..model import Solid
from .bodies import Pose
from .given import number
from .sensor import TactileSensor

Array = NDArray[np.float64]

#: Values of `SensorData` that can be stacked.
STACKED = (
    "image", "marker_px", "marker_visible", "marker_pos", "wrench", "node_pos", "node_force",
    "slipping", "friction", "margin", "limit_margin", "time",
)  # fmt: skip


def update_all(
    sensors: Sequence[TactileSensor],
    object_pos: ArrayLike,
    object_quat: ArrayLike | None = None,
    *,
    dt: float,
    each: Callable[..., Any] = map,
) -> dict[int, str]:
    """Move the objects of B sensors, and begin the next frame.

    On silicone, an object that was just attached is put at its pose, without friction on its way.
    A sensor that cannot follow its pose keeps its state, and the others go on.

    Parameters
    ----------
    sensors: sensors with attached objects
    object_pos: places of the objects' origins in the sensors' frames [m], shape (B, 3)
    object_quat: their turns as quaternions (w, x, y, z), shape (B, 4) (default: none)
    dt: time since the last frame [s]
    each: `map`, or the `map` of a pool of threads

    Returns
    -------
    reasons of the sensors that could not follow, by their numbers

    Raises
    ------
    UserError
        For arrays of another shape, a time that is not above 0, and a sensor without an object.
    """
    count = len(sensors)
    if not number(dt, "dt") > 0.0:
        raise UserError(f"dt = {dt} must be above 0 s")
    places = _numbers(object_pos, 3, "object_pos", count)
    unturned = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    turns = unturned if object_quat is None else _numbers(object_quat, 4, "object_quat", count)

    def move(k: int) -> str:
        sensor = sensors[k]
        with located(f"sensor {k}"):
            placed = sensor.data.index == 0 and sensor.ability.objects is Solid
        try:
            pose = Pose(place=tuple(places[k]), turn=tuple(turns[k]))
            sensor.update(pose, dt=dt, placed=placed)
        except UserError as error:
            return str(error)
        return ""

    return {k: reason for k, reason in enumerate(each(move, range(count))) if reason}


def stacked(
    sensors: Sequence[TactileSensor], name: str, each: Callable[..., Any] = map
) -> NDArray[Any]:
    """Stack a value of the current frames of B sensors in a new array, shape (B, …).

    Parameters
    ----------
    sensors: sensors of one design
    name: value of `SensorData`, such as `image`, `wrench` or `margin`
    each: `map`, or the `map` of a pool of threads

    Raises
    ------
    UserError
        For another name, a sensor without an object, and values of different shapes.
    """
    if name not in STACKED:
        raise UserError(f"no values {name!r} can be stacked; allowed are {', '.join(STACKED)}")

    def value(k: int) -> NDArray[Any]:
        with located(f"sensor {k}"):
            return np.asarray(getattr(sensors[k].data, name))

    values = list(each(value, range(len(sensors))))
    for k, one in enumerate(values):
        if one.shape != values[0].shape:
            raise UserError(f"sensor {k}: {name} has shape {one.shape}, not {values[0].shape}")
    return np.stack(values)


def relative_poses(
    tip_pos: ArrayLike, tip_quat: ArrayLike, object_pos: ArrayLike, object_quat: ArrayLike
) -> tuple[Array, Array]:
    """Poses of objects in the frames of sensors, from both poses in the world.

    Parameters
    ----------
    tip_pos, object_pos: places of the sensors' and the objects' origins [m], shape (3,) or (B, 3)
    tip_quat, object_quat: quaternions (w, x, y, z), shape (4,) or (B, 4)

    Returns
    -------
    places [m] and quaternions (w, x, y, z), of the same shapes

    Raises
    ------
    UserError
        For arrays of other shapes, and for quaternions of length 0.
    """
    away = _numbers(object_pos, 3, "object_pos") - _numbers(tip_pos, 3, "tip_pos")
    tip, obj = _numbers(tip_quat, 4, "tip_quat"), _numbers(object_quat, 4, "object_quat")
    if any((np.linalg.norm(quat, axis=-1) < 1e-6).any() for quat in (tip, obj)):
        raise UserError("a quaternion has length 0")
    back = Rotation.from_quat(tip, scalar_first=True).inv()
    turn = back * Rotation.from_quat(obj, scalar_first=True)
    return back.apply(away), turn.as_quat(scalar_first=True)


def _numbers(values: ArrayLike, last: int, name: str, count: int | None = None) -> Array:
    """Array of numbers of shape (count, last); without a count, of shape (last,) or (B, last)."""
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        array = np.zeros(0)
    one = count is None and array.shape == (last,)
    if not one and (array.ndim != 2 or array.shape != (count or len(array), last)):
        shapes = f"({last},) or (B, {last})" if count is None else f"({count}, {last})"
        raise UserError(f"{name} must be numbers of shape {shapes}, got shape {array.shape}")
    return array
