"""Parts of every page: the state in words, the camera's picture, a legend, curves."""

import html
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..control import GripObservation
from ..loop.sample import Sample
from .picture import MOTION, Image, blank_picture
from .strips import Row, Strips
from .view import OBJECT, PRESSED, SKIN, SLIPS, STICKS

if TYPE_CHECKING:
    import viser

#: Colours of the view and of the picture, each with its meaning.
_LEGEND = (
    ("beige", tuple(SKIN), "skin"),
    ("blue", tuple(PRESSED), "pressed, the bluer the more"),
    ("black", STICKS, "friction where skin sticks"),
    ("orange", SLIPS, "friction where it slips"),
    ("green", MOTION, "motion of a marker × 4, in the picture"),
)
_OBJECT = ("grey-green", OBJECT, "object")


class Board:
    """State, picture, legend and curves of a page.

    Parameters
    ----------
    server: server of the page
    label: label of the picture
    truth: whether the page shows an object and its true forces
    """

    def __init__(self, server: "viser.ViserServer", label: str, truth: bool = True) -> None:
        self._server, self._truth = server, truth
        self._due = self._curves_due = 0.0
        server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        server.gui.main_panel.dock_right()
        self._status = server.gui.add_markdown("starting …")
        self._picture = server.gui.add_image(blank_picture(), label=label, format="jpeg")
        self.strips: Strips | None = None

    def finish(self) -> None:
        """Put legend and curves below the controls added so far."""
        with self._server.gui.add_folder("colours", expand_by_default=False):
            self._server.gui.add_html(legend_text(self._truth))
        self.strips = Strips(self._server, self._truth)

    def is_due(self, at_once: bool = False) -> bool:
        """Return True if another picture is due, and set the time of the next one."""
        now = time.perf_counter()
        if now < self._due and not at_once:
            return False
        every = 1.0 / 30.0  # time between two pictures of the page [s]
        self._due = now + every
        return True

    def show(self, picture: Image, lines: Sequence[str], at_once: bool = False) -> None:
        """Show a picture and the state in Markdown, and the curves at once or at their time."""
        self._picture.image = picture
        self.say(lines)
        now = time.perf_counter()
        curves_every = 1.0 / 10.0  # time between two drawings of its curves [s]
        if self.strips is not None and (at_once or now >= self._curves_due):
            self._curves_due = now + curves_every
            self.strips.draw()

    def add(self, row: Row) -> None:
        """Append a frame to the curves."""
        if self.strips is not None:
            self.strips.add(row)

    def say(self, lines: Sequence[str]) -> None:
        """Show the state in lines of Markdown, in which only ** is markup."""
        # Characters that begin HTML, a link or a picture, which viser would read from a file.
        plain = str.maketrans({c: f"&#{ord(c)};" for c in "&<>[`\\"})
        self._status.content = "<br/>".join(line.translate(plain) for line in lines)


def legend_text(truth: bool) -> str:
    """HTML of the legend: a patch of each colour with its meaning."""
    rows = (*_LEGEND, _OBJECT) if truth else _LEGEND
    parts = []
    for name, (red, green, blue), words in rows:
        patch = (
            f'<span style="display:inline-block;width:1em;height:1em;vertical-align:-0.15em;'
            f'border:1px solid #888;background:rgb({red},{green},{blue})"></span>'
        )
        parts.append(f"<div>{patch} {html.escape(name)}: {html.escape(words)}</div>")
    curves = "curves: estimate orange and dashed" + (", truth blue" if truth else "")
    inner = "".join([*parts, f"<div>{curves}, 90 % interval pale orange, grip grey</div>"])
    return f'<div style="font-size:0.8em;line-height:1.6;padding:0.4em 0.8em">{inner}</div>'


def line_of_speed(seconds: float, updates: float, speed: float, late: int = 0) -> str:
    """Time and updates per second, with a notice if the machine is behind, or frames were late."""
    line = f"**t = {seconds:.2f} s**, {updates:.0f} updates/s"
    if late:
        line += f", {late} frame{'s' * (late > 1)} read late"
    behind = f": this machine is behind, at {speed:.2f} × real time"
    slow = 0.98  # speed below which the page says that the machine is too slow
    return line + (behind if speed < slow else "")


def line_of_truth(sample: Sample) -> str:
    """True Γ and forces."""
    field = sample.field
    margin = field.safety_margin(sample.friction)
    return line_of_forces("true", margin, field.total_normal, field.total_friction)


def line_of_forces(
    kind: str, margin: float, normal: float, friction: float, interval: str = ""
) -> str:
    """Γ with its interval, and the sums of the forces [N]."""
    return f"{kind}: Γ {margin:.2f}{interval}, ΣFn {normal:.2f} N, ΣFf {friction:.2f} N"


def line_of_estimate(observation: GripObservation | None) -> str:
    """Estimated Γ with its interval, and forces, or the reason for no estimate.

    It is empty for a dropped frame.
    """
    if observation is None:
        return ""
    if observation.no_estimate:
        return f"**no estimate:** {observation.no_estimate}"
    low, high = observation.margin_interval
    normal, friction = observation.field.total_normal, observation.field.total_friction
    interval = f" ({low:.2f} to {high:.2f})"
    return line_of_forces("estimated", observation.margin, normal, friction, interval)
