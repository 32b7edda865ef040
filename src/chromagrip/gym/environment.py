"""The environment for Gymnasium: hold an object gently, with one grip force.

Observation: `margin`, `forces`, `markers` or `image`, see `observations`.
Action: in [−1, 1], shape (1,): the grip force from 0 to `most_n`, or its rate.
Reward: in each frame 1 − applied force/`most_n` if the object is held (touched, and sliding by
less than 0.1 mm/s), minus 50·(sliding in this frame)/`dropped_mm`.
Terminated: the object slid by `dropped_mm`, was released under its load, or the model failed;
in the last two cases the reward of that frame is −50.
Truncated: the scene is over.

In a scene of two fingers both must touch the object. Terminated: it was dropped, turned or crushed,
or the model failed; the reward of that frame is −50.
"""

import math
from collections.abc import Collection, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from ..errors import UserError
from ..loop.methods import choose
from ..loop.pinch.stage import Stage, draw_side, set_stage
from ..loop.rig import Rig, RigState
from ..output.processes import one_thread
from ..scene.fingers import build_pinch, fingers
from ..scene.scene import PathName, Scene, load_scene
from ..sensing.reader import Reading
from ..tracking import Tracks
from .observations import Image, ObservationName, observation_of, observed, space_of
from .status import GripStatus, limit_of, status_of
from .window import Window

#: Attributes of an environment that are pickled as they are.
_KEPT = ("spec", "action_space", "observation_space", "_over")
#: Reward lost by sliding until a drop.
DROP_COST = 50.0

Observation = NDArray[np.generic]
Action = NDArray[np.float32]
Info = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class EnvState:
    """State from which the next step of an environment starts.

    Attributes
    ----------
    rig: state of the grasp
    grip: commanded force [N]
    seen: last reading of each finger that arrived
    waiting: readings on their way, by the number of their frame
    touched: whether there was a contact so far
    random: state of the generator from which seeds are drawn
    """

    rig: RigState
    grip: float
    seen: tuple[Reading, ...]
    waiting: dict[int, tuple[Reading, ...]]
    touched: bool
    random: Mapping[str, Any]


class GripEnv(gymnasium.Env[Observation, Action]):
    """A grasp as an environment of Gymnasium, which makes it with `gymnasium.make`.

    Parameters
    ----------
    scene: name of a shipped scene, or a `.toml` file
    observation: `margin`, `forces`, `markers` or `image`; the last two come from the camera
    action: `force` or `rate` of the force
    path: path from which `margin` and `forces` come (default `truth`, which is fast)
    changes: changes to the scene, by dotted key, such as `{"object.friction": 0.3}`
    most_n: largest grip force (default: 5, or what holds 1.2 times the scene's largest load with a
        margin of 0.3 at a friction of 0.3, if that is more) [N]; an attribute of the environment,
        which changes of a single grasp leave as it is
    rate_n_per_s: largest rate of the grip force (default 20) [N/s]
    dropped_mm: sliding of the whole contact that counts as a drop with one finger [mm] (default
        1; with two fingers `pinch.dropped_mm` of the scene)
    render_mode: `rgb_array` returns the camera's picture, or one of two fingers from the side;
        `human` shows it in a window (default: no picture)
    allow: modules that the scene's file may name, see `load_scene`

    Raises
    ------
    UserError
        For a scene or an option that cannot be used.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as in the base class)
        "render_modes": ["rgb_array", "human"],
        "render_fps": 100,
    }

    def __init__(
        self,
        scene: str = "camera-100hz",
        observation: ObservationName = "margin",
        action: Literal["force", "rate"] = "force",
        path: PathName | None = None,
        changes: Mapping[str, Any] | None = None,
        most_n: float | None = None,
        rate_n_per_s: float = 20.0,
        dropped_mm: float | None = None,
        render_mode: str | None = None,
        allow: Collection[str] = (),
    ) -> None:
        _check(observation=(observation, ("image", "markers", "forces", "margin")))
        _check(action=(action, ("force", "rate")))
        _check(render_mode=(render_mode, (None, *self.metadata["render_modes"])))
        for name, value in (
            ("most_n", most_n),
            ("rate_n_per_s", rate_n_per_s),
            ("dropped_mm", dropped_mm),
        ):
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise UserError(f"{name} = {value} must be finite and above 0")
        self._given: dict[str, Any] = {
            "scene": scene,
            "observation": observation,
            "action": action,
            "path": path,
            "changes": dict(changes or {}),
            "most_n": most_n,
            "rate_n_per_s": rate_n_per_s,
            "dropped_mm": dropped_mm,
            "render_mode": render_mode,
            "allow": tuple(allow),
        }
        self._name, self._changes, self._allow = scene, dict(changes or {}), allow
        self._path = _path_of(observation, path)
        self._kind, self._action = observation, action
        self._rate, self._limit = rate_n_per_s, dropped_mm
        self.render_mode = render_mode
        self._window: Window | None = None
        self._opened: dict[str, Any] | None = None
        self._stage: Stage | None = None
        self._rig = self._open({})
        opened = self._rig.scene
        self.most_n = _most_n(opened) if most_n is None else most_n
        self.metadata = {**self.metadata, "render_fps": opened.camera.rate_hz}
        each = fingers(opened)
        rests: list[Tracks | None] = [None for _ in each]
        if observation == "markers":
            with self._threads():
                self._rig.reset()
            rests = [reading.rest for reading in self._rig.readings]
        self._kinds = [observation_of(observation, *of) for of in zip(each, rests, strict=True)]
        self.observation_space = space_of(self._kinds)
        self.action_space = Box(-1.0, 1.0, (1,), np.float32)
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Begin a grasp; the scene's seed is drawn from the environment's generator.

        Parameters
        ----------
        seed: seed of the environment's generator (default: go on with it)
        options: `changes` to the scene for this grasp, in addition to the environment's own
        """
        super().reset(seed=seed)
        changes = dict((options or {}).get("changes", {}))
        if changes != self._opened:
            self._rig.close()
            self._rig = self._open(changes)
        with self._threads():
            self._rig.reset(seed=int(self.np_random.integers(2**32)))
            self._grip, self._touched, self._over = 0.0, False, False
            self._waiting: dict[int, tuple[Reading, ...]] = {}
            self._seen = self._shown()
            self._arrive()
            self._show()
        return observed(self._kinds, self._seen, self._grip), self._info(self._status())

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, Info]:
        """Grip until the next frame; the module's docstring describes the result.

        Raises
        ------
        UserError
            Before `reset`, after the end, and for an action that is not finite.
        """
        if self._over:
            raise UserError("step() is not possible before reset() or after the end; call reset()")
        self._grip = self._force(action)
        before = self._status().slid
        gave_up = ""
        with self._threads():
            try:
                self._rig.step(self._grip)
            except UserError as error:  # the model failed: the force is already checked
                gave_up = str(error)
            else:
                self._arrive()
            self._show()
        status = self._status()
        slid = status.slid - before
        self._touched |= status.touched
        sliding = 0.1e-3  # slowest motion of the whole contact that counts as sliding [m/s]
        held_now = status.touched and slid < sliding * self._rig.scene.period
        reward = held_now * (1.0 - self._rig.applied / self.most_n)
        reward -= DROP_COST * slid / self._dropped
        if status.unpaid or gave_up:
            reward = -DROP_COST
        # On a chain the model fails if a load acts on an object without contact.
        dropped = status.outcome == "dropped" or (bool(gave_up) and not status.touched)
        terminated = status.outcome != "held" or bool(gave_up)
        truncated = self._rig.done and status.outcome != "dropped"
        self._over = terminated or truncated
        info = self._info(status, dropped)
        if gave_up:
            info["gave_up"] = gave_up
        return (
            observed(self._kinds, self._seen, self._grip),
            float(reward),
            terminated,
            truncated,
            info,
        )

    def render(self) -> Any:
        """Picture, uint8, shape (H, W, 3), in the mode `rgb_array`; else None."""
        if self.render_mode == "rgb_array" and self._rig.index >= 0:
            with self._threads():
                return self._picture().copy()
        return None

    def close(self) -> None:
        """Release the camera and the window; closing it again does nothing."""
        self._rig.close()
        if self._window is not None:
            self._window.close()

    def save(self) -> EnvState:
        """State of the environment, from which it can go on later, any number of times."""
        return EnvState(
            rig=self._rig.save(),
            grip=self._grip,
            seen=self._seen,
            waiting=dict(self._waiting),
            touched=self._touched,
            random=self.np_random.bit_generator.state,
        )

    def restore(self, state: EnvState) -> None:
        """Go on from a saved state, with the same bytes as then.

        Raises
        ------
        UserError
            For a state of another scene.
        """
        self._rig.restore(state.rig)
        self._grip, self._seen, self._touched = state.grip, state.seen, state.touched
        self._waiting = dict(state.waiting)
        self.np_random.bit_generator.state = state.random
        self._over = self._rig.done or self._status().outcome != "held"

    def __getstate__(self) -> dict[str, Any]:
        """Options, spaces and, after a reset, the state: a pickled environment goes on from it."""
        begun = hasattr(self, "_grip")
        return {
            "given": self._given,
            "kept": {name: getattr(self, name) for name in _KEPT},
            "changes": self._opened,
            "state": self.save() if begun else None,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        GripEnv.__init__(self, **state["given"])
        if state["state"] is not None:
            self.reset(options={"changes": state["changes"]})
            self.restore(state["state"])
        vars(self).update(state["kept"])

    def _open(self, changes: dict[str, Any]) -> Rig:
        """Open a rig of the scene with changes."""
        merged = {"path": self._path} | self._changes | changes
        plain = {key: _plain(value) for key, value in merged.items()}
        scene, methods = choose(load_scene(self._name, plain, allow=self._allow))
        self._dropped = limit_of(scene, self._limit)
        rig = Rig(scene, methods)
        self._opened, self._stage = changes, None
        return rig

    def _force(self, action: Action) -> float:
        """Grip force of an action [N]."""
        share = float(np.asarray(action, dtype=float).reshape(-1)[0])
        if not math.isfinite(share):
            raise UserError(f"action {share} is not finite; allowed is -1 to 1")
        share = min(max(share, -1.0), 1.0)
        if self._action == "force":
            return 0.5 * (share + 1.0) * self.most_n
        change = share * self._rate * self._rig.scene.period
        return min(max(self._grip + change, 0.0), self.most_n)

    def _arrive(self) -> None:
        """Send this frame's readings on their way, and take those that arrive."""
        rig = self._rig
        if all(reading.observation is not None for reading in rig.readings):
            self._waiting[rig.index] = self._shown()
        for one in rig.arrived:
            self._seen = self._waiting.pop(one.index)

    def _shown(self) -> tuple[Reading, ...]:
        """Reading of each finger in this frame, with its picture if `image` is observed."""
        readings = self._rig.readings
        if self._kind != "image":
            return readings
        pictures = zip(readings, self._rig.pictures(), strict=True)
        return tuple(replace(reading, frame=frame) for reading, frame in pictures)

    def _status(self) -> GripStatus:
        """Status of the object so far."""
        return status_of(self._rig, self._dropped, self._touched)

    def _info(self, status: GripStatus, dropped: bool = False) -> Info:
        """True values of this frame; not for a policy."""
        info = {
            "time_s": self._rig.time,
            "grip_n": self._grip,
            "applied_n": self._rig.applied,
            **status.truth,
            "dropped": dropped,
        }
        # There is no margin without contact; NaN is not equal to itself.
        return {key: value for key, value in info.items() if value == value}

    def _picture(self) -> Image:
        """Picture for people: the camera's, or for two fingers one from the side."""
        rig = self._rig
        if rig.scene.fingers == 1:
            return rig.picture().image
        if self._stage is None:
            size = (640, 480)  # width and height of the picture [px]
            self._stage = set_stage(build_pinch(rig.scene), rig.scene.duration_s, size, size)
        return draw_side(self._stage, rig.truth)

    def _show(self) -> None:
        """Draw the picture in the window, in the mode `human`."""
        if self.render_mode == "human":
            self._window = self._window or Window(f"chromagrip: {self._name}")
            self._window.draw(self._picture())

    def _threads(self) -> Any:
        """Limit this process to one thread, except for a chain without pictures."""
        pictures = self._path == "camera" or self._kind == "image" or self.render_mode is not None
        two = self._rig.scene.fingers > 1  # their steps solve with BLAS
        return one_thread() if pictures or two else nullcontext()


def _most_n(scene: Scene) -> float:
    """Largest grip force of an environment that is given none [N]."""
    usual, times, gravity = 5.0, 1.2, 9.81
    # Not the scene's friction: the scale of the actions would tell it.
    friction = 0.3
    loads = {1: max(map(abs, scene.load.forces_n), default=0.0)}
    loads[2] = 0.5e-3 * scene.pinch.mass_g * gravity  # each finger bears a half
    margin = scene.target_margin or 0.3
    needed = loads[scene.fingers] / (friction * (1.0 - margin))
    return max(usual, times * needed)


def _path_of(observation: ObservationName, path: PathName | None) -> PathName:
    """Path of the scene that an observation needs."""
    if observation == "markers":
        if path == "truth":
            raise UserError('observation = "markers" comes from the camera; path must be "camera"')
        return "camera"
    if observation == "image":  # no forces are estimated from it
        return "truth"
    return path or "truth"


def _plain(value: Any) -> Any:
    """Convert a value from NumPy's types, which a scene does not accept."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _check(**options: tuple[object, tuple[object, ...]]) -> None:
    """Refuse options that are not among the allowed ones."""
    for name, (value, allowed) in options.items():
        if value not in allowed:
            words = ", ".join(str(one) for one in allowed)
            raise UserError(f"{name} = {value!r}: allowed are {words}")
