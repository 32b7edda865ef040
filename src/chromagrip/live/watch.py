"""The page of a camera, a video or a folder of pictures: tracks and estimates, no truth."""

import math
import time
from collections import deque
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field, replace
from threading import Event
from typing import TYPE_CHECKING

from ..errors import UserError, located
from ..loop.sample import Sample
from ..model.dome import lattice
from ..output.processes import one_thread
from ..pictures.opening import Opened, open_tracking
from ..sensing.observers import ForceObserver
from ..sensing.reader import DEFAULT_WINDOW, Reading
from ..sources.delivery import in_words
from ..sources.feed import Feed
from ..tracking import (
    DEFAULT_TRACKER,
    Palette,
    SensorCalibration,
    check_reconstructor,
    load_calibration,
)
from ..tracking.forces import DOME_METHODS, name_used
from .board import Board, line_of_estimate, line_of_speed
from .picture import picture_of
from .serve import Address, announce, serving, ticks
from .solid import Array, half_sphere
from .strips import row_of
from .view import FingertipView, drawn_forces
from .worker import Background

if TYPE_CHECKING:
    import viser


@dataclass(frozen=True, kw_only=True)
class Looked:
    """A frame of a source for the page.

    Attributes
    ----------
    reading: reading of the frame
    updates: frames per second [Hz]
    speed: speed of the source's time over real time
    skipped: number of a camera's frames skipped so far
    delivery: frames that did not come as they should so far, in words
    """

    reading: Reading
    updates: float
    speed: float
    skipped: int
    delivery: str


@dataclass(frozen=True, kw_only=True)
class Looking:
    """A source, and the methods for reading its pictures.

    Attributes
    ----------
    source, rest, fps: as in `open_tracking`
    calibration: name or file of the calibration, see `load_calibration`
    reconstructor: name of the reconstructor, see `load_reconstructor`
    """

    source: str
    rest: str
    fps: float | None
    calibration: str
    reconstructor: str

    @property
    def known(self) -> SensorCalibration:
        """Calibration of the sensor.

        Raises
        ------
        UserError
            When the name is unknown, or it is not for forces.
        """
        known = load_calibration(self.calibration)
        if known.sensor.shape.flat:
            raise UserError(
                f"calibration {self.calibration} is for a flat pad, which has no force model; "
                "`chromagrip estimate` reads its displacements"
            )
        check_reconstructor(self.reconstructor, known)
        return known

    def open(self) -> Opened:
        """Open the source from its beginning, with the frames at rest that `rest` names."""
        known = self.known
        palette = Palette.of_sensor(known.sensor)
        opened = open_tracking(
            self.rest, self.source, find=lambda *_: palette, tracker=DEFAULT_TRACKER, noise=None,
            fps=self.fps, tell=lambda _: None, sensor=known.sensor,
        )  # fmt: skip
        with located(f"calibration {self.calibration}"):
            forces = ForceObserver(known, opened.resting, self.reconstructor, DEFAULT_WINDOW)
        return replace(opened, reader=opened.reader.with_forces(forces))


@dataclass
class Watcher(Background):
    """Tracks and estimates frame after frame in a thread of its own; a context.

    Attributes
    ----------
    looking: source and calibration
    first: opened source
    show: function called with each frame, in that thread
    tell: function called with a sentence when the source ends or fails
    paused: whether it is paused
    """

    _nap = 0.02

    looking: Looking
    first: Opened
    show: Callable[[Looked], None]
    tell: Callable[[str], None]
    paused: bool = False
    _steps: int = 0
    _restart: Event = field(default_factory=Event)

    patience = 2.0  # one that waits for a camera must not block the end

    def restart(self) -> None:
        """Open the source again, with new frames at rest."""
        self._restart.set()

    def step_once(self) -> None:
        """Read one frame while it is paused."""
        self._steps += 1

    def _run(self) -> None:
        opened: Opened | None = self.first
        with one_thread():
            while not self._stop.is_set():
                self._restart.clear()
                try:
                    self._look(opened or self.looking.open())
                    self.tell(f"**{self.looking.source} has ended;** restart shows it again")
                except UserError as error:
                    self.tell(f"**{error};** restart tries it again")
                opened = None
                while not (self._stop.wait(self._nap) or self._restart.is_set()):
                    pass

    def _look(self, opened: Opened) -> None:
        """Read frames of the source until it ends or must start again."""
        source = replace(opened.source, frames=lambda: opened.frames)
        ends: deque[tuple[float, float]] = deque(maxlen=30)
        frame_within = 10.0  # time in which the next frame must come [s]
        source.delivery.go_on()
        with closing(Feed(source, frame_within)) as feed:
            while not (self._stop.is_set() or self._restart.is_set()):
                if self.paused and not self._steps:
                    self._stop.wait(self._nap)
                    ends.clear()
                    continue
                self._steps = max(0, self._steps - 1)
                frame = feed.next()
                if frame is None:
                    return
                reading = opened.reader.update(frame)
                if ends and not source.live:  # a file is shown at its own rate
                    due = ends[-1][0] + frame.time - ends[-1][1]
                    self._stop.wait(max(0.0, due - time.perf_counter()))
                ends.append((time.perf_counter(), frame.time))
                updates, speed = _rates(ends, source.live)
                self.show(
                    Looked(
                        reading=reading,
                        updates=updates,
                        speed=speed,
                        skipped=feed.skipped,
                        delivery=in_words(source.delivery.counts),
                    )
                )


def _rates(ends: deque[tuple[float, float]], live: bool) -> tuple[float, float]:
    """Frames per second, and speed of the source over real time, which is 1 for a camera."""
    span = ends[-1][0] - ends[0][0]
    if not span > 0.0:
        return 0.0, 1.0
    return (len(ends) - 1) / span, 1.0 if live else (ends[-1][1] - ends[0][1]) / span


def serve_source(looking: Looking, address: Address) -> None:
    """Serve the page of a camera, a video or a folder of pictures until Ctrl-C.

    Parameters
    ----------
    looking: source, and the methods for reading its pictures
    address: address of the page

    Raises
    ------
    UserError
        When the address, the source or the calibration cannot be used.
    """
    first = looking.open()
    with serving(address) as server:
        page = WatchPage(server, looking)
        with Watcher(looking, first, page.show, page.tell) as watcher:
            page.connect(watcher)
            announce(address, server)
            for _ in ticks(address.seconds):
                watcher.check()


class WatchPage:
    """The page of a source of pictures.

    Parameters
    ----------
    server: server of the page
    looking: source of the pictures
    """

    def __init__(self, server: "viser.ViserServer", looking: Looking) -> None:
        self._watcher: Watcher | None = None
        self._state = list[str]()
        self._view = FingertipView(server)
        self._view.lay(_skin(looking), None)
        label = "the source, with the motion of the markers × 4"
        self.board = Board(server, label, truth=False)
        buttons = server.gui.add_button_group("source", ("pause", "step", "restart"))
        buttons.on_click(lambda event: self.press(event.target.value))
        self.board.finish()

    def connect(self, watcher: Watcher) -> None:
        """Connect the buttons with a watcher."""
        self._watcher = watcher

    def press(self, button: str) -> None:
        """Do the action of a button."""
        watcher = self._watcher
        if watcher is None:
            return
        if button == "pause":
            watcher.paused = not watcher.paused
        elif button == "step":
            watcher.paused = True
            watcher.step_once()
        else:
            watcher.restart()

    def show(self, looked: Looked) -> None:
        """Show a frame if a picture is due."""
        reading = looked.reading
        observation, frame = reading.observation, reading.frame
        assert observation is not None
        assert frame is not None
        sample = Sample(index=0, time=frame.time, readings=(reading,), grip=math.nan)
        self.board.add(row_of(sample))
        stands = self._watcher is not None and self._watcher.paused
        if not self.board.is_due(stands):
            return
        self._view.show(drawn_forces(observation.field, observation.friction))
        self._state = [
            line_of_speed(frame.time, looked.updates, looked.speed),
            line_of_estimate(observation),
        ]
        if not observation.no_estimate and math.isfinite(observation.friction):
            low, high = observation.friction_interval
            guess = "" if observation.friction_observable else ": a guess, the skin does not slip"
            self._state.append(f"µ {observation.friction:.2f} ({low:.2f} to {high:.2f}){guess}")
        if looked.skipped:
            self._state.append(f"{looked.skipped} frames left out: this machine is slower")
        if looked.delivery:
            self._state.append(f"frames of the source: {looked.delivery}")
        picture = picture_of(frame.image, reading.tracks, reading.rest)
        self.board.show(picture, self._state, stands)

    def tell(self, sentence: str) -> None:
        """Show that the source ended or failed."""
        self.board.say([*self._state, sentence])


def _skin(looking: Looking) -> Array:
    """Points of the skin on which forces are estimated [m], shape (N, 3)."""
    known = looking.known
    if name_used(looking.reconstructor, known) in DOME_METHODS:
        return lattice(known.sensor.dome).points
    return half_sphere(known.fingertip.radius)
