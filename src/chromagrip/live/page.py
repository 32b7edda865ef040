"""The page of a live grasp: sliders, the changes that they make, and the display of a frame."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from ..errors import UserError
from ..scene.controllers import CONTROLLERS
from ..scene.scene import Body, Scene
from .board import Board, line_of_estimate, line_of_speed, line_of_truth
from .guard import LARGEST_FILE
from .picture import picture_of
from .session import Session, Shown
from .sliders import OBJECTS, SliderValues, scene_for, slider_values
from .strips import row_of
from .view import GraspView

if TYPE_CHECKING:
    import viser

#: Kinds of files that may be dropped in as an object.
MESHES = (".stl", ".obj", ".ply")
_OF_THE_SCENE = "of the scene"
Slider = tuple[str, str, float, float, float, str]
#: Sliders for every body and for each body: label, name, lowest and highest value, step, hint.
_ALWAYS: tuple[Slider, ...] = (
    ("load [N]", "load", 0.0, 3.0, 0.01, "lateral force on the object"),
    ("µ of the object", "friction", 0.1, 1.5, 0.01, "friction coefficient"),
    ("stiffness [kPa]", "stiffness", 20.0, 1000.0, 10.0, "Young's modulus of the object"),
)
_OF_BODY: dict[Body, tuple[Slider, ...]] = {
    "chain": (),
    "dome": (
        ("azimuth [°]", "azimuth", -180.0, 180.0, 1.0, "direction of the load about the axis"),
        ("twist [N mm]", "twist", -10.0, 10.0, 0.1, "torque on the object about the axis"),
    ),
}
_RESTARTING = (
    ("noise [levels]", "noise", 0.5, 10.0, 0.5, "noise of the camera; starts the grasp again"),
    ("latency [frames]", "latency", 0, 10, 1, "from image to command; starts the grasp again"),
)
#: Designs with which pictures of each body can be read.
_DESIGNS = {"dome": ("thesis", "dome-2020", "dome-2022"), "chain": ("thesis",)}


class Page:
    """The page of one session; a context that keeps the files dropped onto it.

    Parameters
    ----------
    server: server of the page
    base: scene that the sliders change

    Attributes
    ----------
    started: whether a frame has been shown
    """

    def __init__(self, server: "viser.ViserServer", base: Scene) -> None:
        self._server, self._base = server, base
        self._session: Session | None = None
        self._applied, self.started = 0.0, False
        self._refused = self._kept = ""
        self._state: list[str] = []
        self._folder = TemporaryDirectory(prefix="chromagrip-")
        self._meshes: dict[str, str] = {}
        self.view = GraspView(server)
        self.board = Board(server, "camera, with the motion of the markers × 4")
        self._add_controls(slider_values(base))
        self.board.finish()

    def __enter__(self) -> "Page":
        """Use as a context."""
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the files that were dropped onto the page."""
        self._folder.cleanup()

    def connect(self, session: Session) -> None:
        """Connect the sliders with a session."""
        self._session = session

    def show(self, shown: Shown) -> None:
        """Show a frame if a picture is due; called by the session."""
        sample, self.started = shown.sample, True
        self.board.add(row_of(sample))
        self._applied = sample.applied
        stands = self._session is not None and self._session.paused
        if not self.board.is_due(stands):
            return
        self.view.begin(shown.scene)
        self.view.show(self.view.drawn(sample, self._forces.value == "estimated"))
        image = None if sample.frame is None else sample.frame.image
        self._state = self._lines(shown)
        self.board.show(picture_of(image, sample.tracks, sample.rest), self._said(), stands)
        if self._automatic.value:  # the slider shows what the controller does
            self._grip.value = round(self._applied, 2)

    def tell(self, sentence: str) -> None:
        """Show the reason for which a value is refused; "" removes it."""
        self._refused = f"**Refused:** {sentence}" if sentence else ""
        self.board.say(self._said())

    def tell_kept(self, sentence: str) -> None:
        """Show the state of a recording."""
        self._kept = sentence
        if self._session is not None:
            wanted = self._session.recorder.wanted
            self._record.label = "stop recording" if wanted else "record"
        self.board.say(self._said())

    def _said(self) -> list[str]:
        """State of the grasp, last refusal, and state of the recording."""
        return [line for line in (*self._state, self._refused, self._kept) if line]

    def _lines(self, shown: Shown) -> list[str]:
        """State of the grasp in Markdown."""
        sample = shown.sample
        lines = [
            line_of_speed(sample.time, shown.updates, shown.speed, shown.late),
            line_of_truth(sample),
            line_of_estimate(sample.observation),
        ]
        if sample.time > 0.0 and not sample.field.contact.any():
            lines.append("**the object has no contact:** press restart")
        return lines

    def _add_controls(self, first: SliderValues) -> None:
        """Add sliders and buttons."""
        gui = self._server.gui
        self._forces = gui.add_dropdown("forces shown", ("estimated", "true"))
        self._automatic = gui.add_checkbox("controller grips", first.automatic)
        self._grip: Any = gui.add_slider("grip [N]", 0.0, 10.0, 0.01, first.grip, disabled=True)
        self._automatic.on_update(lambda _: self._take_over())
        self._grip.on_update(lambda _: self._ask_grip())
        for slider in _ALWAYS + _OF_BODY[self._base.body]:
            self._add_slider(slider, first)
        buttons = gui.add_button_group("grasp", ("pause", "step", "restart"))
        buttons.on_click(lambda event: self._press(event.target.value))
        hint = "keeps the grasp from now on in a run folder, until it is pressed again"
        self._record = gui.add_button("record", hint=hint)
        self._record.on_click(lambda _: self._press("record"))
        with gui.add_folder("starts the grasp again", expand_by_default=False):
            self._add_choice("controller", "controller", tuple(CONTROLLERS.entries), first)
            self._add_choice("design", "sensor", _DESIGNS[self._base.body], first)
            {"chain": lambda first: None, "dome": self._add_object}[self._base.body](first)
            for slider in _RESTARTING:
                self._add_slider(slider, first)

    def _add_object(self, first: SliderValues) -> None:
        """Add the choice of the object, and its tilt."""
        self._objects = self._add_choice("object", "object", (_OF_THE_SCENE, *OBJECTS), first)
        self._add_upload()
        self._add_slider(("tilt [°]", "tilt", -20.0, 20.0, 1.0, "turn about y"), first)

    def _add_slider(self, slider: Slider, first: SliderValues) -> None:
        """Add a slider; its first value is clipped to its ends."""
        label, name, low, high, step, hint = slider
        value = min(max(getattr(first, name), low), high)
        made = self._server.gui.add_slider(label, low, high, step, value, hint=hint)
        made.on_update(lambda _: self._ask(**{name: made.value}))

    def _add_choice(
        self, label: str, name: str, options: tuple[str, ...], first: SliderValues
    ) -> Any:
        """Add a choice of a slider value."""
        value = getattr(first, name) or options[0]
        if value not in options:
            options = (value, *options)
        choice = self._server.gui.add_dropdown(label, options, initial_value=value)

        def chosen(_: Any) -> None:
            value = "" if choice.value == _OF_THE_SCENE else choice.value
            self._ask(**{name: self._meshes.get(value, value)})

        choice.on_update(chosen)
        return choice

    def _add_upload(self) -> None:
        """Add a button that loads an object from a file."""
        kinds = ", ".join(MESHES)
        button = self._server.gui.add_upload_button(
            f"object from a file ({kinds})", mime_type=",".join(MESHES), hint="closed, in mm"
        )
        button.on_upload(
            lambda event: self.drop(event.target.value.name, event.target.value.content)
        )

    def drop(self, name: str, content: bytes) -> None:
        """Use the object of a file, or show the reason for refusing it; the grasp goes on.

        Parameters
        ----------
        name: name of the file
        content: content of the file; empty for a file that is too large
        """
        name = Path(name).name
        suffix = Path(name).suffix.lower()
        path = Path(self._folder.name) / f"{len(self._meshes) + 1}{suffix}"
        try:
            if suffix not in MESHES:
                raise UserError(f"{name}: an object is a file {', '.join(MESHES)}")
            if not 0 < len(content) <= LARGEST_FILE:
                most = LARGEST_FILE // 10**6
                raise UserError(f"{name} is empty or too large; at most {most} MB are allowed")
            path.write_bytes(content)
            session = self._session
            sliders = slider_values(self._base) if session is None else session.sliders
            scene_for(self._base, replace(sliders, object=str(path)))
        except UserError as error:
            path.unlink(missing_ok=True)
            self.tell(str(error).replace(str(path), name))
            return
        self._refused = ""
        self._meshes[name] = str(path)
        self._objects.options = tuple(dict.fromkeys((*self._objects.options, name)))
        if self._objects.value == name:  # the same file again, which may be another one now
            self._ask(object=str(path))
        self._objects.value = name

    def _take_over(self) -> None:
        """Let the controller grip, or the slider, which begins at the present grip."""
        automatic = bool(self._automatic.value)
        self._grip.disabled = automatic
        if not automatic:
            self._grip.value = round(self._applied, 2)
        self._ask(automatic=automatic, grip=float(self._grip.value))

    def _ask_grip(self) -> None:
        if not self._automatic.value:
            self._ask(grip=float(self._grip.value))

    def _ask(self, **changes: Any) -> None:
        if self._session is not None:
            self._session.ask(replace(self._session.sliders, **changes))

    def _press(self, button: str) -> None:
        session = self._session
        if session is None:
            return
        actions: dict[str, Callable[[], None]] = {
            "pause": lambda: setattr(session, "paused", not session.paused),
            "step": session.step_once,
            "restart": session.restart,
            "record": self._toggle_record,
        }
        if button == "step":
            session.paused = True
        actions[button]()

    def _toggle_record(self) -> None:
        """Begin a recording, or end it."""
        session = self._session
        assert session is not None
        session.recorder.wanted = not session.recorder.wanted
        self._record.label = "stop recording" if session.recorder.wanted else "record"
