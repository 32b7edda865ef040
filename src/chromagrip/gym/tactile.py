"""Wrappers that add a tactile sensor to environments of other people.

    env = TactileObservation(env, "dome-2020", ball(8e-3), pose_of, friction=0.5)
    observation, info = env.reset()
    observation["tactile"]

`pose_of(env)` returns the place of the object [m] and its quaternion (w, x, y, z) in the sensor's
frame. The observation becomes a dictionary, or stays one, with the key `tactile`. Where the
silicone does not describe a pose, the sensor keeps its last state, and `info` says why.
"""

from collections.abc import Callable
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from ..errors import UserError
from ..sensing.given import number
from ..sensing.many import TactileSensors, Touchable
from ..sensing.sensor import TactileSensor

#: What can be observed: the picture, shifts of the markers [px], or the wrench [N, N·m].
Shown = Literal["image", "markers", "forces"]
#: Places of objects [m] and their quaternions (w, x, y, z), in the frames of the sensors.
Poses = tuple[ArrayLike, ArrayLike]
Values = NDArray[Any]

#: Key of the observation, and of the reason why a pose is not described, in `info`.
KEY, FAILED = "tactile", "tactile_failed"
#: Largest shift of a marker [px], force [N] and torque [N·m] of the spaces.
_MOST_PX, _MOST_N, _MOST_NM = 100.0, 100.0, 1.0


class TactileObservation(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment whose observation has the key `tactile`.

    Parameters
    ----------
    env: environment of any kind
    design: name or file of a sensor's design, or a design
    obj: object that the sensor touches, or its shape
    pose_of: function from `env` to the place (3,) [m] and quaternion (4,) of the object in the
        sensor's frame
    shown: `image`, uint8, shape (H, W, 3); `markers`, shifts from rest [px], shape
        (2, M, 2), 0 where the lens shows none; or
        `forces`, the wrench on the sensor about its origin [N, N·m], shape (6,)
    dt: time of a step [s] (default: `env.unwrapped.dt`)
    friction: µ of a shape
    options: of the `TactileSensor`, such as `noise` and `seed`

    Raises
    ------
    UserError
        For a sensor or an object that cannot be used, and when the time of a step is not known.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        design: Any,
        obj: Touchable,
        pose_of: Callable[[Any], Poses],
        *,
        shown: Shown = "image",
        dt: float | None = None,
        friction: float | None = None,
        **options: Any,
    ) -> None:
        super().__init__(env)
        self._pose_of, self._dt = pose_of, _step_of(env, dt)
        self._sensed = _Sensed(design, 1, obj, friction, shown, options)
        self.observation_space = _with(env.observation_space, self._sensed.space)

    @property
    def sensor(self) -> TactileSensor:
        """The sensor, whose `data` has the truth."""
        return self._sensed.sensors.sensors[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment, and put the object down on the sensor."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._sensed.sensors.reset()
        return self._seen(observation, info)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment, and move the object on the sensor."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        observation, info = self._seen(observation, info)
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Close the environment and the sensor."""
        super().close()
        self._sensed.sensors.close()

    def _seen(self, observation: Any, info: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        place, turn = _poses_of(self._pose_of, self.env)
        seen = self._sensed((np.reshape(place, (1, -1)), np.reshape(turn, (1, -1))), self._dt)
        (reason,) = self._sensed.sensors.data.reasons
        return _joined(observation, seen[0]), info | ({FAILED: reason} if reason else {})


class VectorTactileObservation(VectorWrapper):
    """A vector of environments with one batched sensor, as `TactileObservation`.

    Parameters
    ----------
    env: vector of B environments
    pose_of: function from `env` to the places (B, 3) [m] and quaternions (B, 4) of the objects
    obj: object or shape, one for all or a sequence of one each
    design, shown, dt, friction, options: as of `TactileObservation`; also `threads`

    Raises
    ------
    UserError
        As `TactileObservation`.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        design: Any,
        obj: Any,
        pose_of: Callable[[Any], Poses],
        *,
        shown: Shown = "image",
        dt: float | None = None,
        friction: float | None = None,
        **options: Any,
    ) -> None:
        super().__init__(env)
        if env.metadata.get("autoreset_mode") == AutoresetMode.SAME_STEP:
            raise UserError(
                "autoreset_mode SAME_STEP would lose the last observation; take another one"
            )
        self._pose_of, self._dt = pose_of, _step_of(env, dt)
        self._sensed = _Sensed(design, env.num_envs, obj, friction, shown, options)
        single = _with(env.single_observation_space, self._sensed.space)
        self.single_observation_space = single
        self.observation_space = batch_space(single, env.num_envs)
        self._over = np.zeros(env.num_envs, dtype=np.bool_)

    @property
    def sensors(self) -> TactileSensors:
        """The sensors, whose `data` has the truth."""
        return self._sensed.sensors

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environments, or those of `options["reset_mask"]`, and their sensors."""
        chosen = (options or {}).get("reset_mask")
        observation, info = self.env.reset(seed=seed, options=options)
        self._sensed.sensors.reset(chosen)
        self._over[:] = False
        return self._seen(observation, info)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step the environments; the sensors of those that begin again begin again, too."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        disabled = self.env.metadata.get("autoreset_mode") == AutoresetMode.DISABLED
        if self._over.any() and not disabled:
            self._sensed.sensors.reset(self._over)
        self._over = terminated | truncated
        observation, info = self._seen(observation, info)
        return observation, reward, terminated, truncated, info

    def close(self, **kwargs: Any) -> None:
        """Close the environments and the sensors."""
        super().close(**kwargs)
        self._sensed.sensors.close()

    def _seen(self, observation: Any, info: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        seen = self._sensed(_poses_of(self._pose_of, self.env), self._dt)
        data = self._sensed.sensors.data
        if data.failed.any():
            info = info | {FAILED: np.array(data.reasons, dtype=object), f"_{FAILED}": data.failed}
        return _joined(observation, seen), info


class _Sensed:
    """Sensors of one design, and what is observed of them."""

    def __init__(
        self,
        design: Any,
        count: int,
        obj: Any,
        friction: float | None,
        shown: Shown,
        options: dict[str, Any],
    ) -> None:
        if shown not in ("image", "markers", "forces"):
            raise UserError(f"shown = {shown!r}: allowed are image, markers, forces")
        self.sensors = TactileSensors(design, num_envs=count, **options)
        self.sensors.attach(obj, friction=friction)
        self._shown, data = shown, self.sensors.data
        view = self.sensors.sensors[0].design.view
        self._rest = data.marker_px.copy() if shown == "markers" else np.zeros(0)
        if shown == "image":
            shape = view.height, view.width, 3
            self.space: spaces.Box[Any] = spaces.Box(0, 255, shape, np.uint8)
        elif shown == "markers":
            self.space = _box(np.full(self._rest.shape[1:], _MOST_PX))
        else:
            self.space = _box(np.repeat([_MOST_N, _MOST_NM], 3))

    def __call__(self, poses: Poses, dt: float) -> Values:
        """Move the objects; return what is observed, with an axis of environments in front."""
        data = self.sensors.update(*poses, dt)
        if self._shown == "image":
            return data.image.copy()
        values = data.wrench
        if self._shown == "markers":
            values = np.nan_to_num(data.marker_px - self._rest)  # NaN outside the lens
        clipped: Values = np.clip(values, self.space.low, self.space.high).astype(np.float32)
        return clipped


def _box(most: NDArray[np.float64]) -> spaces.Box:
    high = most.astype(np.float32)
    return spaces.Box(-high, high, dtype=np.float32)


def _with(space: spaces.Space[Any], tactile: spaces.Space[Any]) -> spaces.Dict:
    """Space of an observation with the key `tactile`."""
    inside = dict(space.spaces) if isinstance(space, spaces.Dict) else {"observation": space}
    if KEY in inside:
        raise UserError(f"the environment's observation already has the key {KEY!r}")
    return spaces.Dict(inside | {KEY: tactile})


def _joined(observation: Any, seen: Values) -> dict[str, Any]:
    inside = observation if isinstance(observation, dict) else {"observation": observation}
    return {**inside, KEY: seen}


def _step_of(env: Any, dt: float | None) -> float:
    """Time of a step [s]."""
    found = getattr(env.unwrapped, "dt", None) if dt is None else dt
    if found is None:
        raise UserError("the environment does not tell the time of a step; give dt [s]")
    if not number(found, "dt") > 0.0:
        raise UserError(f"dt = {found} must be above 0 s")
    return float(found)


def _poses_of(pose_of: Callable[[Any], Poses], env: Any) -> Poses:
    """What the user's function returns."""
    found = pose_of(env)
    if not (isinstance(found, tuple | list) and len(found) == 2):
        raise UserError(f"pose_of returned {found!r}; expected a place and a quaternion")
    return found[0], found[1]
