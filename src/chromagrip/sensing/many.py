"""Many tactile sensors of one design, in step: poses of all objects in; batched arrays out.

    sensor = chromagrip.TactileSensor("dome-2020", num_envs=16, noise=2.0, seed=0)
    sensor.attach(shapes.mesh("mug.obj"), friction=0.6)
    sensor.update(object_pos, object_quat, dt)
    sensor.data.image, sensor.data.wrench, sensor.data.margin

Environment k is the specimen of `seed` + k: its bytes depend neither on the number of environments
nor on the number of threads.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from ..errors import UserError
from ..model import ContactObject, Solid
from ..model.shapes import Shape
from .bodies import Pose
from .given import number
from .sensor import SensorState
from .sensor import TactileSensor as TactileSensor

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]
#: What an environment's sensor may touch: an object, or a shape with a friction.
Touchable = Solid | ContactObject | Shape


class TactileSensors:
    """B tactile sensors of one design; made by `TactileSensor(design, num_envs=B, …)`.

    Parameters
    ----------
    design, body, noise, defects, renderer: as of `TactileSensor`
    num_envs: number B of environments
    seed: specimen and noise of environment k are those of `seed` + k
    threads: number of threads that step and draw environments
    rate_hz: rate of the pictures; `data.image` stays the same between two of them (default: one
        for each update)

    Raises
    ------
    UserError
        As `TactileSensor`, and for numbers of environments or threads below 1.
    """

    def __init__(
        self,
        design: Any,
        *,
        num_envs: int,
        seed: int = 0,
        threads: int = 1,
        rate_hz: float | None = None,
        **options: Any,
    ) -> None:
        for name, count in (("num_envs", num_envs), ("threads", threads)):
            if count != int(count) or count < 1:
                raise UserError(f"{name} = {count!r} must be a whole number from 1")
        if rate_hz is not None and not rate_hz > 0.0:
            raise UserError(f"rate_hz = {rate_hz} must be above 0 Hz")
        first = TactileSensor(design, seed=seed, **options)
        others = (TactileSensor(first.design, seed=seed + k, **options) for k in range(1, num_envs))
        self.sensors: tuple[TactileSensor, ...] = (first, *others)
        self._period = 0.0 if rate_hz is None else 1.0 / rate_hz
        self._pool = ThreadPoolExecutor(int(threads)) if threads > 1 else None
        self._data: BatchData | None = None
        self._soft = first.ability.objects is Solid
        self._moved = np.zeros(num_envs, dtype=np.bool_)

    @property
    def num_envs(self) -> int:
        """Number B of environments."""
        return len(self.sensors)

    @property
    def data(self) -> "BatchData":
        """Values of the current frame.

        Raises
        ------
        UserError
            Before `attach`.
        """
        if self._data is None:
            raise UserError("data is not available before attach(); call attach() first")
        return self._data

    def attach(
        self,
        obj: Touchable | Sequence[Touchable],
        *,
        friction: float | None = None,
        stiffness: float | None = None,
    ) -> None:
        """Attach an object to all environments, or one to each, and begin with it above the apex.

        Parameters
        ----------
        obj: object, or a shape; or one for each environment
        friction, stiffness: µ and stiffness per area [N/m³] of a shape (default: those of `Solid`)

        Raises
        ------
        UserError
            For objects that the body cannot touch, and when their number is not that of the
            environments.
        """
        if isinstance(obj, str):
            raise UserError(f"{obj!r} is no object; shapes.mesh({obj!r}) reads a file")
        several = isinstance(obj, Sequence)
        if several and len(obj) != self.num_envs:  # type: ignore[arg-type]
            raise UserError(
                f"{len(obj)} objects are given for {self.num_envs} environments; "  # type: ignore[arg-type]
                "give one, or one for each"
            )
        given: list[Any] = list(obj) if several else [obj] * self.num_envs  # type: ignore[arg-type]
        solids: list[Solid | ContactObject] = []
        for one in given:
            own = {"friction": friction, "stiffness": stiffness}
            own = {n: number(value, n) for n, value in own.items() if value is not None}
            if isinstance(one, Shape):
                solids.append(Solid(shape=one, **own))  # type: ignore[arg-type]
            elif own:
                raise UserError(f"give {' and '.join(own)} with a shape, or in the object itself")
            else:
                solids.append(one)
        self._each(lambda k: self.sensors[k].attach(solids[k]))
        self._moved[:] = False
        self._data = BatchData(self)

    def reset(self, env_ids: ArrayLike | None = None) -> None:
        """Begin again with the attached objects, in all environments or in some.

        Raises
        ------
        UserError
            Before `attach`, and for an environment that is not there.
        """
        data = self.data
        chosen = self._chosen(env_ids)
        for k in chosen:
            self.sensors[k].reset()
        self._moved[chosen] = False
        data._begin(chosen)

    def update(
        self,
        object_pos: ArrayLike | None = None,
        object_quat: ArrayLike | None = None,
        dt: float = 1.0 / 60.0,
        *,
        force: ArrayLike | None = None,
    ) -> "BatchData":
        """Move the objects, or load them, and begin the next frame.

        The first time after `attach` and `reset` an object on silicone is put at its pose, without
        friction on its way. An environment whose pose is none, or whose model gives up, as for an
        object too deep in the silicone, keeps its last state: `data.failed` and `data.reasons` say
        so, and the others go on.

        Parameters
        ----------
        object_pos: places of the objects' origins in the sensors' frames [m], shape (B, 3)
        object_quat: their turns as quaternions (w, x, y, z), shape (B, 4) (default: none)
        dt: time since the last frame [s]
        force: instead of poses, forces on the objects [N], see `TactileSensor.update`, shape (B, 3)

        Raises
        ------
        UserError
            Before `attach`, for arrays of another shape, and for poses and forces together.
        """
        data, count = self.data, self.num_envs
        if (object_pos is None) == (force is None):
            raise UserError("update() needs object_pos or force, and not both")
        if not number(dt, "dt") > 0.0:
            raise UserError(f"dt = {dt} must be above 0 s")
        if force is not None:
            forces = _rows(force, (count, 3), "force")
            data._next(self._each(lambda k: self._load(k, forces[k], dt)))
            return data
        assert object_pos is not None
        places = _rows(object_pos, (count, 3), "object_pos")
        unturned = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
        turns = unturned if object_quat is None else _rows(object_quat, (count, 4), "object_quat")
        data._next(self._each(lambda k: self._move(k, places[k], turns[k], dt)))
        return data

    def _move(self, k: int, place: Array, turn: Array, dt: float) -> str:
        """Move the object of an environment; return why it could not be moved, or nothing."""
        try:
            pose, first = _pose(place, turn), self._soft and not self._moved[k]
            self.sensors[k].update(pose, dt=dt, placed=first)
            self._moved[k] = True
        except UserError as error:
            return str(error)
        return ""

    def _load(self, k: int, force: Array, dt: float) -> str:
        """Load the object of an environment, as `_move`."""
        try:
            self.sensors[k].update(force=force, dt=dt)
            self._moved[k] = True
        except UserError as error:
            return str(error)
        return ""

    def state(self) -> tuple[SensorState, ...]:
        """States of all environments, from which they can go on later, any number of times."""
        return tuple(sensor.state() for sensor in self.sensors)

    def restore(self, states: Sequence[SensorState]) -> None:
        """Go on from a value of `state`: the next frames are the same bytes as then.

        Raises
        ------
        UserError
            For states of another number of environments or another body.
        """
        if len(states) != self.num_envs:
            raise UserError(f"{len(states)} states are given for {self.num_envs} environments")
        for sensor, state in zip(self.sensors, states, strict=True):
            sensor.restore(state)
        self._moved[:] = True
        self._data = BatchData(self)

    def close(self) -> None:
        """Release renderers and threads; closing again does nothing."""
        for sensor in self.sensors:
            sensor.close()
        if self._pool is not None:
            self._pool.shutdown()

    def _each(self, do: Callable[[int], Any]) -> list[Any]:
        """Do something for every environment, in order or in threads."""
        numbers_ = range(self.num_envs)
        return list(map(do, numbers_) if self._pool is None else self._pool.map(do, numbers_))

    def _chosen(self, env_ids: ArrayLike | None) -> list[int]:
        """Numbers of environments.

        Raises
        ------
        UserError
            For an environment that is not there.
        """
        if env_ids is None:
            return list(range(self.num_envs))
        chosen = np.atleast_1d(np.asarray(env_ids))
        if chosen.size == 0:
            return []
        if chosen.dtype == np.bool_ and chosen.shape == (self.num_envs,):
            chosen = np.flatnonzero(chosen)
        whole = chosen.ndim == 1 and np.issubdtype(chosen.dtype, np.integer)
        if not whole or not ((chosen >= 0) & (chosen < self.num_envs)).all():
            raise UserError(
                f"env_ids = {env_ids!r} must be whole numbers from 0 to {self.num_envs - 1}"
            )
        return [int(k) for k in chosen]


TactileSensor.several = TactileSensors


class BatchData:
    """Pictures and truth of one frame of B environments; arrays are valid until the next update.

    Values are computed when they are first read. M is the number of markers a layer, N that of the
    nodes of the skin.

    Attributes
    ----------
    failed: environments whose model gave up in the last update, bool, shape (B,)
    reasons: why, one sentence for each environment; empty where it did not
    time: since the start [s], shape (B,)
    """

    def __init__(self, sensors: TactileSensors) -> None:
        self._of = sensors
        count = sensors.num_envs
        self.failed: Mask = np.zeros(count, dtype=np.bool_)
        self.reasons: tuple[str, ...] = ("",) * count
        self.time: Array = np.array([sensor.data.time for sensor in sensors.sensors])
        self._due = np.zeros(count)
        self._kept: dict[str, NDArray[Any]] = {}
        self._arrays: dict[str, NDArray[Any]] = {}
        self._drawn = np.zeros(count, dtype=np.bool_)

    @property
    def image(self) -> Image:
        """Pictures, RGB, uint8, shape (B, H, W, 3), drawn when first read, or at `rate_hz`."""
        sensors = self._of.sensors
        if "image" not in self._arrays:
            view = sensors[0].design.view
            shape = (len(sensors), view.height, view.width, 3)
            self._arrays["image"] = np.empty(shape, dtype=np.uint8)
        pictures, period = self._arrays["image"], self._of._period

        def draw(k: int) -> None:
            if self._drawn[k] or (period and self.time[k] < self._due[k] - 1e-9):
                return
            pictures[k] = sensors[k].data.image
            self._drawn[k] = True
            if period:
                self._due[k] = (np.floor(self.time[k] / period + 1e-9) + 1.0) * period

        self._of._each(draw)
        return pictures

    @property
    def marker_px(self) -> Array:
        """Projected centres of the markers [px], shape (B, 2, M, 2)."""
        return self._read("marker_px")

    @property
    def marker_visible(self) -> Mask:
        """Markers that lie in the picture, bool, shape (B, 2, M)."""
        return self._read("marker_visible")

    @property
    def marker_pos(self) -> Array:
        """Centres of the markers in the sensors' frames [m], shape (B, 2, M, 3)."""
        return self._read("marker_pos")

    @property
    def wrench(self) -> Array:
        """Force of the objects on the sensors, torque about their origins [N, N·m], (B, 6)."""
        return self._read("wrench")

    @property
    def node_pos(self) -> Array:
        """Places of the nodes of the skin [m], shape (B, N, 3)."""
        return self._read("node_pos")

    @property
    def node_force(self) -> Array:
        """Forces of the objects on the nodes [N], shape (B, N, 3)."""
        return self._read("node_force")

    @property
    def slipping(self) -> Mask:
        """Nodes whose friction is near its limit, bool, shape (B, N)."""
        return self._read("slipping")

    @property
    def friction(self) -> Array:
        """µ of the objects, shape (B,)."""
        return self._read("friction")

    @property
    def margin(self) -> Array:
        """Safety margins Γ with the objects' µ, shape (B,); NaN without contact."""
        return self._read("margin")

    @property
    def limit_margin(self) -> Array:
        """Margins of friction and torsion together, shape (B,); NaN without contact."""
        return self._read("limit_margin")

    def _read(self, name: str) -> NDArray[Any]:
        """Values of all environments, in an array that the next update writes over."""
        if name not in self._kept:
            each = self._of._each(lambda k: np.asarray(getattr(self._of.sensors[k].data, name)))
            out = self._arrays.get(name)
            if out is None or out.shape[1:] != each[0].shape:
                out = np.empty((len(each), *each[0].shape), dtype=each[0].dtype)
                self._arrays[name] = out
            self._kept[name] = np.stack(each, out=out)
        return self._kept[name]

    def _next(self, reasons: Sequence[str]) -> None:
        """Begin the next frame."""
        self.reasons = tuple(reasons)
        self.failed = np.array([bool(reason) for reason in reasons])
        self.time = np.array([sensor.data.time for sensor in self._of.sensors])
        self._kept.clear()
        self._drawn[:] = False

    def _begin(self, chosen: Sequence[int]) -> None:
        """Begin again in some environments."""
        self.time = self.time.copy()
        self.time[list(chosen)] = self._due[list(chosen)] = 0.0
        self._kept.clear()
        self._drawn[list(chosen)] = False


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


def _numbers(values: ArrayLike, last: int, name: str) -> Array:
    """Array of finite numbers of shape (last,) or (B, last)."""
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.ndim not in (1, 2) or array.shape[-1] != last or not np.isfinite(array).all():
        raise UserError(f"{name} must be finite numbers of shape ({last},) or (B, {last})")
    return array


def _rows(values: ArrayLike, shape: tuple[int, int], name: str) -> Array:
    """Array of numbers of that shape."""
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise UserError(f"{name} must be numbers of shape {shape}") from None
    if array.shape != shape:
        raise UserError(f"{name} has shape {array.shape}, expected {shape}")
    return array


def _pose(place: Array, turn: Array) -> Pose:
    """Pose of a row; a quaternion need not have length 1."""
    size = float(np.linalg.norm(turn))
    if not 1e-6 < size < np.inf:
        raise UserError(f"object_quat = {turn.tolist()} has length {size:g}; a turn has length 1")
    return Pose(place=tuple(place.tolist()), turn=tuple((turn / size).tolist()))
