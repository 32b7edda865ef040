"""A grasp that goes on while its sliders change."""

import time
from collections import deque
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from threading import Lock

from ..errors import UserError
from ..loop.latency import HoldingController
from ..loop.methods import Methods
from ..loop.rig import Rig
from ..loop.sample import Sample
from ..output.processes import one_thread
from ..scene.scene import Scene
from .record import Recorder
from .sliders import SliderValues, scene_for, slider_values
from .worker import Background


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A frame for the page.

    Attributes
    ----------
    sample: truth and estimates of the frame
    scene: scene of the grasp, with the changes of the sliders
    updates: frames computed per second [Hz]
    speed: speed of the grasp over real time
    late: frames of the grasp so far whose reading took longer than they last
    """

    sample: Sample
    scene: Scene
    updates: float
    speed: float
    late: int


@dataclass
class Session(Background):
    """A live grasp in a thread of its own; a context.

    Attributes
    ----------
    base: scene that the sliders change
    show: function called with each frame, in that thread
    tell: function called with the reason of a refusal or an end of the grasp, and "" at a start
    recorder: recorder of the grasp
    paused: whether the grasp is paused
    """

    #: Interval at which a paused grasp checks for changes [s].
    _nap = 0.02

    base: Scene
    show: Callable[[Shown], None]
    tell: Callable[[str], None]
    recorder: Recorder
    paused: bool = False
    _sliders: SliderValues = field(init=False)
    _restart: bool = False
    _steps: int = 0
    _lock: Lock = field(default_factory=Lock)

    def __post_init__(self) -> None:
        self._sliders = slider_values(self.base)

    @property
    def sliders(self) -> SliderValues:
        """Present values of the sliders."""
        return self._sliders

    def ask(self, sliders: SliderValues) -> None:
        """Go on, or start again, with other values."""
        with self._lock:
            self._sliders = sliders

    def restart(self) -> None:
        """Begin another grasp with the same sliders."""
        with self._lock:
            self._restart = True

    def step_once(self) -> None:
        """Compute one frame of a paused grasp."""
        with self._lock:
            self._steps += 1

    def _run(self) -> None:
        refused: SliderValues | None = None
        with one_thread():
            while not self._stop.is_set():
                sliders = self._sliders
                if sliders == refused:
                    self._stop.wait(self._nap)
                    continue
                try:
                    self._grasp(sliders)
                except UserError as error:
                    self.tell(str(error))
                    refused = sliders
                except Exception as error:  # allowed values may be too much together
                    self.tell(f"the grasp failed ({type(error).__name__}: {error})")
                    refused = sliders
                else:
                    refused = None
                finally:
                    self.recorder.finish()

    def _grasp(self, sliders: SliderValues) -> None:
        """Run one grasp, until another has to begin."""
        scene = scene_for(self.base, sliders)
        methods = Methods.of_scene(scene)
        with self._lock:
            self._restart = False
        with closing(Rig(scene, methods)) as rig:
            controller = HoldingController(methods.build_controller(scene), scene.controller)
            first = rig.reset()
            controller.start(first)
            self.tell("")
            ends: deque[float] = deque([time.perf_counter()])
            late = 0
            while not (self._stop.is_set() or rig.done):
                now, again = self._sliders, self._restart
                if again or now.restarts != sliders.restarts:
                    return
                if self._waits():
                    if not self.recorder.wanted:
                        self.recorder.finish()
                    self._stop.wait(self._nap)
                    ends.clear()
                    continue
                if now != sliders:
                    rig.change(scene_for(self.base, now))
                    if now.automatic and not sliders.automatic and rig.reading.observation:
                        controller.start(rig.reading.observation)
                    sliders = now
                grip = controller.command(rig.arrived) if now.automatic else now.grip
                sample = rig.sample(grip)
                if self.recorder.wanted:
                    self.recorder.take(sample, rig, now)
                else:
                    self.recorder.finish()
                rig.step(grip)
                self._pace(ends, scene.period)
                span = max(ends[-1] - ends[0], 1e-9)
                rate = (len(ends) - 1) / span if len(ends) > 1 else 0.0
                late += sum(one.seconds for one in sample.readings) > scene.period
                speed = rate * scene.period
                self.show(
                    Shown(sample=sample, scene=rig.scene, updates=rate, speed=speed, late=late)
                )

    def _waits(self) -> bool:
        """Return True if the grasp must wait; a requested step is used up."""
        with self._lock:
            if not self.paused:
                self._steps = 0
                return False
            if self._steps:
                self._steps -= 1
                return False
            return True

    def _pace(self, ends: deque[float], period: float) -> None:
        """Wait until a frame's period is over, and note its end."""
        now = time.perf_counter()
        if ends and now < ends[-1] + period:
            self._stop.wait(ends[-1] + period - now)
        ends.append(time.perf_counter())
        speed_over = 1.0  # time over which the speed is averaged [s]
        while len(ends) > 2 and ends[-1] - ends[0] > speed_over:
            ends.popleft()
