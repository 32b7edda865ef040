"""The page of a finished run: time slider, play, pause and step."""

import bisect
import math
import threading
import time
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from ..loop.results.run_folder import RunRead
from ..scene.fingers import need_one_finger
from .board import Board, line_of_forces
from .picture import blank_picture, unpacked
from .replay import Replay, not_repeated
from .serve import Address, announce, serving, ticks
from .strips import FRAMES, Row, rows_of
from .view import GraspView

if TYPE_CHECKING:
    import viser


def serve_run(run: RunRead, address: Address) -> None:
    """Serve the page of a finished run until Ctrl-C.

    Parameters
    ----------
    run: run that was read
    address: address of the page

    Raises
    ------
    UserError
        When the address cannot be used, or the run cannot be shown.
    """
    need_one_finger(run.scene, f"see report.html of {run.folder}: the live page shows")
    with serving(address) as server:
        view = GraspView(server)
        if not not_repeated(run):
            view.begin(run.scene)
        with Replay(run, view) as replay:
            page = RunPage(server, replay)
            announce(address, server)
            for _ in ticks(address.seconds, 1.0 / 30.0):
                page.tick()
                replay.check()


class RunPage:
    """The page of a finished run.

    Parameters
    ----------
    server: server of the page
    replay: frames of the run
    """

    def __init__(self, server: "viser.ViserServer", replay: Replay) -> None:
        self._replay, self._run = replay, replay.run
        self._rows = rows_of(self._run.columns)
        self._end = self._rows[-1]["time_s"]
        self._now, self._then = 0.0, time.monotonic()
        self._playing, self._changed = True, threading.Event()
        gui, camera = server.gui, self._run.scene.path == "camera"
        # Frames from outside have no truth.
        truth = any(not math.isnan(row["normal_true_n"]) for row in self._rows)
        self.board = Board(server, "camera", truth)
        period = max(self._run.scene.period, 1e-3)
        self._slider: Any = gui.add_slider("time [s]", 0.0, max(self._end, period), period, 0.0)
        self._slider.on_update(self._moved)
        self._speed = gui.add_dropdown("speed", ("1", "1/4", "1/20"))
        self._forces = gui.add_dropdown(
            "forces shown", ("estimated", "true") if camera else ("true",)
        )
        self._forces.on_update(lambda _: self._changed.set())
        buttons = gui.add_button_group("run", ("play", "pause", "step", "restart"))
        buttons.on_click(lambda event: self.press(event.target.value))
        self.board.finish()
        self._shown: list[Row] = []

    def press(self, button: str) -> None:
        """Do the action of a button."""
        if button == "restart":
            self._now = 0.0
        if button == "step":
            count = self._count(self._now)
            self._now = self._rows[count]["time_s"] if count < len(self._rows) else 0.0
        self._playing = button in ("play", "restart")
        if button == "play" and self._now >= self._end:
            self._now = 0.0
        self._changed.set()

    def _moved(self, event: Any) -> None:
        if event.client_id is not None:  # by a hand, not by the time
            self._now, self._playing = float(self._slider.value), False
            self._changed.set()

    def tick(self) -> None:
        """Advance the time while it plays, and show changes."""
        now = time.monotonic()
        passed, self._then = now - self._then, now
        if self._playing:
            there = self._end if self._replay.ended else self._reached()
            self._now = min(self._now + passed * float(Fraction(self._speed.value)), there)
            self._playing = self._now < self._end
            self._changed.set()
        if self._changed.is_set() or not self._replay.ended:
            self._changed.clear()
            self._show()

    def _reached(self) -> float:
        """Time up to which frames of the run exist [s]."""
        return self._replay.frames[-1].time if self._replay.frames else 0.0

    def _show(self) -> None:
        kept = self._replay.at(self._now)
        self._slider.value = self._now
        count = self._count(self._now)
        rows = self._rows[max(0, count - FRAMES) : count]
        picture = blank_picture() if kept is None else unpacked(kept.picture)
        if kept is not None and kept.true is not None and kept.estimated is not None:
            chosen = kept.true if self._forces.value == "true" else kept.estimated
            self._replay.view.show(chosen)
        if self.board.strips is not None:
            self.board.strips.put(rows)
        self.board.show(picture, self._lines(rows[-1] if rows else None), not self._playing)

    def _count(self, time: float) -> int:
        """Number of frames of the run up to a time [s]."""
        return bisect.bisect_right(self._rows, time + 1e-9, key=lambda row: row["time_s"])

    def _lines(self, row: Row | None) -> list[str]:
        """State in Markdown."""
        run = self._run
        lines = [f"**t = {self._now:.2f} s** of {self._end:g} s, {run.folder.name}: a finished run"]
        if row is not None:
            for kind in ("true", "estimated"):
                names = (f"margin_{kind}", f"normal_{kind}_n", f"friction_{kind}_n")
                margin, normal, friction = (row[name] for name in names)
                if not math.isnan(normal):
                    lines.append(line_of_forces(kind, margin, normal, friction))
        lines.append(self._replay.words())
        return lines
