"""The page: sliders, what they ask for, and what a frame shows."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..scene.controllers import CONTROLLERS
from ..scene.scene import Scene
from .session import Session, Shown
from .strips import Strips
from .view import FingertipView, blank_picture, picture_of
from .wishes import OBJECTS, Wishes, wishes_of

if TYPE_CHECKING:
    import viser

#: Times between two pictures of the page, and between two drawings of its curves [s].
EVERY, CURVES_EVERY = 1.0 / 30.0, 1.0 / 10.0
#: Speed below which the page says that the machine is too slow.
_SLOW = 0.98
#: Sliders: label, wish, lowest and highest value, step, hint; those of a dome only come second.
_ALWAYS = (
    ("load [N]", "load", 0.0, 3.0, 0.01, "lateral force on the object"),
    ("µ of the object", "friction", 0.1, 1.5, 0.01, "friction coefficient"),
    ("stiffness [kPa]", "stiffness", 20.0, 1000.0, 10.0, "Young's modulus of the object"),
)
_OF_DOME = (
    ("azimuth [°]", "azimuth", -180.0, 180.0, 1.0, "direction of the load about the axis"),
    ("twist [N mm]", "twist", -10.0, 10.0, 0.1, "torque on the object about the axis"),
)
_ANEW = (
    ("noise [levels]", "noise", 0.5, 10.0, 0.5, "of the camera; begins the grasp anew"),
    ("latency [frames]", "latency", 0, 10, 1, "from image to command; begins the grasp anew"),
)
#: Designs of the two bodies that pictures of them can be read with.
_DESIGNS = {"dome": ("thesis", "dome-2020", "dome-2022"), "chain": ("thesis",)}


class Page:
    """The page of one session.

    Parameters
    ----------
    server: of the page
    base: scene that the sliders change
    """

    def __init__(self, server: "viser.ViserServer", base: Scene) -> None:
        self._server, self._base = server, base
        self._session: Session | None = None
        self._due = self._curves_due = 0.0
        self._applied = 0.0
        self.view = FingertipView(server)
        server.gui.configure_theme(
            control_layout="collapsible", control_width="large", show_logo=False,
            show_share_button=False,
        )  # fmt: skip
        self._status = server.gui.add_markdown("starting …")
        self._picture = server.gui.add_image(
            blank_picture(), label="camera, with the motion of the markers × 4", format="jpeg"
        )
        self._add_controls(wishes_of(base))
        self._strips = Strips(server)

    def connect(self, session: Session) -> None:
        """Let the sliders ask that session."""
        self._session = session

    def show(self, shown: Shown) -> None:
        """Show a frame, where it is time for a picture; called by the session."""
        self._strips.add(shown)
        self._applied = shown.sample.applied
        now = time.perf_counter()
        if now < self._due and not (self._session and self._session.paused):
            return
        self._due = now + EVERY
        self.view.show(shown, self._forces.value == "estimated")
        self._picture.image = picture_of(shown)
        self._status.content = self._said(shown)
        if self._automatic.value:  # the slider shows what the controller does
            self._grip.value = round(self._applied, 2)
        if now >= self._curves_due:
            self._curves_due = now + CURVES_EVERY
            self._strips.draw()

    def tell(self, sentence: str) -> None:
        """Say why a wish is refused; "" where none is."""
        if sentence:
            self._status.content = f"**Refused:** {sentence}"

    def _said(self, shown: Shown) -> str:
        """State of the grasp in Markdown."""
        sample, seen = shown.sample, shown.sample.observation
        true = sample.field.safety_margin(sample.friction)
        lines = [f"**t = {sample.time:.2f} s**, {shown.updates:.0f} updates/s"]
        if shown.speed < _SLOW:
            lines[0] += f": this machine is behind, at {shown.speed:.2f} × real time"
        lines.append(
            f"true: Γ {true:.2f}, ΣFn {sample.field.total_normal:.2f} N, "
            f"ΣFf {sample.field.total_friction:.2f} N"
        )
        if sample.time > 0.0 and not sample.field.contact.any():
            lines.append("**nothing touches the object:** press anew to begin again")
        if seen is not None and seen.no_estimate:
            lines.append(f"**no estimate:** {seen.no_estimate}")
        elif seen is not None:
            low, high = seen.margin_interval
            lines.append(
                f"estimated: Γ {seen.margin:.2f} ({low:.2f} to {high:.2f}), "
                f"ΣFn {seen.field.total_normal:.2f} N, ΣFf {seen.field.total_friction:.2f} N"
            )
        return "<br/>".join(lines)

    def _add_controls(self, first: Wishes) -> None:
        """Sliders and buttons."""
        gui = self._server.gui
        self._forces = gui.add_dropdown("forces shown", ("estimated", "true"))
        self._automatic = gui.add_checkbox("controller grips", first.automatic)
        self._grip: Any = gui.add_slider("grip [N]", 0.0, 10.0, 0.01, first.grip, disabled=True)
        self._automatic.on_update(lambda _: self._take_over())
        self._grip.on_update(lambda _: self._wish_grip())
        dome = self._base.body == "dome"
        for label, name, low, high, step, hint in _ALWAYS + (_OF_DOME if dome else ()):
            self._add_slider(label, name, low, high, step, hint, first)
        buttons = gui.add_button_group("grasp", ("pause", "step", "anew"))
        buttons.on_click(lambda event: self._press(event.target.value))
        with gui.add_folder("begins the grasp anew", expand_by_default=False):
            self._add_choice("controller", "controller", tuple(CONTROLLERS.entries), first)
            self._add_choice("design", "sensor", _DESIGNS[self._base.body], first)
            if dome:
                self._add_choice("object", "object", ("of the scene", *OBJECTS), first)
                self._add_slider("tilt [°]", "tilt", -20.0, 20.0, 1.0, "turn about y", first)
            for label, name, low, high, step, hint in _ANEW:
                self._add_slider(label, name, low, high, step, hint, first)

    def _add_slider(
        self, label: str, name: str, low: float, high: float, step: float, hint: str, first: Wishes
    ) -> None:
        """Slider of a wish, from a value within its ends."""
        value = min(max(getattr(first, name), low), high)
        slider = self._server.gui.add_slider(label, low, high, step, value, hint=hint)
        slider.on_update(lambda _: self._wish(**{name: slider.value}))

    def _add_choice(self, label: str, name: str, options: tuple[str, ...], first: Wishes) -> None:
        """Choice of a wish."""
        value = getattr(first, name) or options[0]
        if value not in options:
            options = (value, *options)
        choice = self._server.gui.add_dropdown(label, options, initial_value=value)

        def chosen(_: Any) -> None:
            self._wish(**{name: "" if choice.value == "of the scene" else choice.value})

        choice.on_update(chosen)

    def _take_over(self) -> None:
        """Let the controller grip, or the slider, which begins at the grip of now."""
        automatic = bool(self._automatic.value)
        self._grip.disabled = automatic
        if not automatic:
            self._grip.value = round(self._applied, 2)
        self._wish(automatic=automatic, grip=float(self._grip.value))

    def _wish_grip(self) -> None:
        if not self._automatic.value:
            self._wish(grip=float(self._grip.value))

    def _wish(self, **changes: Any) -> None:
        if self._session is not None:
            self._session.wish(replace(self._session.wishes, **changes))

    def _press(self, button: str) -> None:
        session = self._session
        if session is None:
            return
        actions: dict[str, Callable[[], None]] = {
            "pause": lambda: setattr(session, "paused", not session.paused),
            "step": session.step_once,
            "anew": session.begin_anew,
        }
        if button == "step":
            session.paused = True
        actions[button]()
