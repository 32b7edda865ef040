"""Map of the reconstructors on domes: one condition changed at a time, until forces are wrong.

A ball is pressed onto the dome and pulled to Γ ≈ .6, .3 and .1. Each reconstructor reads the
pictures from before the touch on, and is scored where grip and load are held.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from ...by_name import Choice
from ...errors import UserError
from ...model import Solid
from ...model.dome import solid_stiffness
from ...model.shapes import ball, plane
from ...output.figure import WIDTH, legend_below, new_figure, png
from ...output.report import Report, Row, reported
from ...tracking import load_reconstructor, sensor_as_designed
from ..study import Asked, Study, study
from ..worlds.dome.grips import MARGINS, UNLIKE, Grip, unlike_shape
from ..worlds.dome.readings import Reading, read
from ..worlds.dome.scenes import SEED, Watched, watch
from ..worlds.dome.sets import BEST, CHAIN, COMPARED
from ..worlds.dome.specimens import Specimen, matched
from ..worlds.force_scores import QUANTITIES
from .fields import draw_cells, patches, remark, title_of
from .panels import Outcome, Outcomes, map_study, score_of, text_of, worst

Array = NDArray[np.float64]

#: Largest errors of ΣFn, as a share, and of Γ of a frame that is read accurately.
ACCURATE = {"normal": 0.1, "margin": 0.1}
#: Outcomes, best first. Where several hold, the last counts.
OUTCOMES: Outcomes = {
    "accurate": Outcome(
        "#8fd0c5", "", f"ΣFn within {100 * ACCURATE['normal']:g} %, Γ within {ACCURATE['margin']:g}"
    ),
    "off, inside twice its interval": Outcome("#e9d26a", "o"),
    "frames flagged": Outcome("#b4c3d6", "f", "some without an estimate"),
    "wrong, narrow and unflagged": Outcome("#d9534f", "w"),
    "not held": Outcome("#eeeeee", "–", "the object slides off"),
}
#: Usual force of the grip [N] of each design, and the reconstructors that read it.
READERS: dict[str, tuple[float, tuple[str, ...]]] = {
    "thesis": (1.0, COMPARED),
    "dome-2022": (3.0, (BEST,)),
}


@dataclass(frozen=True, kw_only=True)
class GripCase:
    """A grip of a sensor, and what is off in it.

    Attributes
    ----------
    noise: of the camera, which is told [grey levels]
    grip: force over the design's usual one
    ball: its radius over that of the dome; infinite for a plane
    tilt: of the plane and of the grip [°]
    modulus: Young's modulus of the object [kPa]
    friction: µ
    young: Young's modulus of the silicone over the one that is told
    shape: `ball`, or one of UNLIKE
    """

    noise: float = 2.0
    grip: float = 1.0
    ball: float = 1.0
    tilt: float = 0.0
    modulus: float = 300.0
    friction: float = 0.5
    young: float = 1.0
    shape: str = "ball"


@dataclass(frozen=True)
class Dial:
    """One condition that is changed: the field of `GripCase` of its name.

    Attributes
    ----------
    label: of the axis, with its unit
    values: from one end to the other
    base: what else is not as usual
    """

    label: str
    values: tuple[float | str, ...]
    base: GripCase = GripCase()


DIALS = {
    "noise": Dial("noise [grey levels]", (1.0, 2.0, 4.0, 8.0, 16.0)),
    "grip": Dial("grip over the usual", (0.03, 0.1, 0.3, 1.0, 3.0)),
    "ball": Dial("radius of the ball over the dome's", (math.inf, 2.0, 1.0, 0.5, 0.25, 0.12)),
    "tilt": Dial("tilt of a plane [°]", (0.0, 5.0, 10.0, 20.0, 30.0), GripCase(ball=math.inf)),
    "modulus": Dial("E of the object [kPa]", (30.0, 100.0, 300.0, 1000.0, 10000.0)),
    "friction": Dial("µ", (0.1, 0.2, 0.5, 0.9, 1.5)),
    "young": Dial("E of the silicone over what is told", (0.7, 0.9, 1.0, 1.1, 1.3)),
    "shape": Dial("shape", ("ball", *UNLIKE)),
}
#: Dials and values of a quick map, of the first design alone.
QUICK: dict[str, tuple[float | str, ...]] = {"noise": (8.0,), "shape": ("ball", "edge")}
#: Direction of the load [°].
_AZIMUTH = 30.0


class ForceCondition(NamedTuple):
    """Design, dial, its value in words, and the reconstructors that read it by name."""

    design: str
    dial: str
    value: str
    methods: dict[str, Choice]


@dataclass(frozen=True)
class ForceCell:
    """One reconstructor at one value of one dial; NaN where no frame was read.

    Attributes
    ----------
    design, method, dial, value: the setting
    outcome: one of OUTCOMES
    normal_percent: largest error of ΣFn of a frame that is read [%]
    margin_error: largest error of Γ
    flagged: frames without an estimate
    frames: of the scene that are scored
    note: why the scene could not be made
    """

    design: str
    method: str
    dial: str
    value: str
    outcome: str
    normal_percent: float
    margin_error: float
    flagged: int
    frames: int
    note: str


@study("stability", "force", method="reconstructor")
def force_map(asked: Asked) -> Study[ForceCondition, list[ForceCell]]:
    """Reconstructors on pictures of domes over one condition at a time.

    Chosen ones are shown next to ours. A quick map has a few values of two conditions, of
    one design.
    """
    own = asked.chosen((), load_reconstructor)
    dials = QUICK if asked.quick else {name: dial.values for name, dial in DIALS.items()}
    return map_study(
        "map",
        [
            ForceCondition(
                design, dial, text_of(value), {**{name: name for name in methods}, **own}
            )
            for dial, values in dials.items()
            for value in values
            for design, (_, methods) in list(READERS.items())[: 1 if asked.quick else None]
        ],
        cells,
        ForceCell,
        report,
        partial(draw_force, quick=asked.quick),
        words=lambda one: f"{one.design}, {one.dial} {one.value}",
    )


def case_of(dial: str, value: str) -> GripCase:
    """Case at a value of a dial."""
    known = next(one for one in DIALS[dial].values if text_of(one) == value)
    changed: dict[str, Any] = {dial: known}
    return replace(DIALS[dial].base, **changed)


def cells(setting: ForceCondition) -> list[ForceCell]:
    """Make the scene of a setting, and let the reconstructors read it."""
    design, dial, value, methods = setting
    try:
        watched = _watched(design, case_of(dial, value))
        if len(watched.scored) <= len(MARGINS):
            raise UserError("the object slides off")
    except UserError as error:
        lost = ("not held", math.nan, math.nan, 0, 0, str(error))
        return [ForceCell(design, name, dial, value, *lost) for name in methods]
    return [
        ForceCell(design, name, dial, value, *judged(read(method, watched), watched.true), "")
        for name, method in methods.items()
    ]


def _watched(design: str, case: GripCase) -> Watched:
    """Pictures of a case, with the truth in its frames."""
    made = matched(design)
    sensor, silicone = made.sensor, made.sensor.silicone
    assert silicone is not None
    stiffer = msgspec.structs.replace(silicone, young_kpa=silicone.young_kpa * case.young)
    sensor = msgspec.structs.replace(sensor, silicone=stiffer)
    specimen = Specimen(sensor=sensor, dome=sensor.round_dome("this bench"), noise=case.noise)
    usual, _ = READERS[design]
    grip = _grip(case, specimen.dome.radius, usual)
    return watch(sensor_as_designed(design), specimen, grip, SEED, case.shape)


def _grip(case: GripCase, radius: float, usual: float) -> Grip:
    """Grip of a case on a dome of that radius [m], whose usual force is that [N]."""
    lean = np.array([0.0, math.radians(case.tilt), 0.0])
    pose = np.concatenate([np.zeros(3), lean])
    shape = ball(radius * case.ball) if math.isfinite(case.ball) else plane()
    if case.shape != "ball":
        shape, pose = unlike_shape(np.random.default_rng(SEED), case.shape, radius)
    return Grip(
        solid=Solid(
            shape=shape,
            stiffness=solid_stiffness(1e3 * case.modulus),
            friction=case.friction,
        ),
        pose=pose,
        lean=lean,
        normal=usual * case.grip,
        azimuth=math.radians(_AZIMUTH),
        margins=MARGINS,
    )


def judged(reading: Reading, true: Array) -> tuple[str, float, float, int, int]:
    """Outcome, errors, and numbers of frames of a reading, as a cell has them.

    Parameters
    ----------
    reading: of the frames of a scene
    true: truth in them, shape (I, 4)
    """
    answers = reading.answers
    kept = ~answers.flagged
    off = abs(answers.value - true)[kept]
    half = 0.5 * np.nan_to_num(np.ptp(answers.interval, axis=-1), nan=0.0, posinf=np.inf)[kept]
    accurate, honest, largest = True, True, {}
    for name, most in ACCURATE.items():
        k = QUANTITIES.index(name)
        scale = true[kept, k] if name == "normal" else np.ones(len(off))
        share = off[:, k] / scale
        accurate &= bool((share <= most).all())
        honest &= bool(((share <= most) | (off[:, k] <= 2.0 * half[:, k])).all())
        largest[name] = float(share.max()) if len(share) else math.nan
    happened = {
        "off, inside twice its interval": not accurate,
        "frames flagged": not bool(kept.all()),
        "wrong, narrow and unflagged": not honest,
    }
    flagged = int(answers.flagged.sum())
    percent = 100.0 * largest["normal"]
    return worst("accurate", happened), percent, largest["margin"], flagged, len(true)


def report(results: Sequence[ForceCell]) -> Report:
    """Outcomes of each reconstructor, and each place where one of domes is wrong and narrow."""
    rows: list[Row] = []
    for design, method in dict.fromkeys((one.design, one.method) for one in results):
        outcomes = [one.outcome for one in results if (one.design, one.method) == (design, method)]
        rows += [
            reported(
                ("force", design, method, score_of(name)),
                outcomes.count(name),
                f"of {len(outcomes)}",
            )
            for name in OUTCOMES
        ]
    wrong = [one for one in results if one.outcome == "wrong, narrow and unflagged"]
    told = [
        f"{one.method} on {one.design} is wrong, narrow and unflagged at {one.dial} {one.value}: "
        f"ΣFn {one.normal_percent:.0f} % off, Γ {one.margin_error:.2f}"
        for one in wrong
        if one.method != CHAIN
    ]
    notes = [f"{one.design}, {one.dial} {one.value}: {one.note}" for one in results if one.note]
    return Report(rows=tuple(rows), notes=(*told, *dict.fromkeys(notes)))


def draw_force(results: Sequence[ForceCell], path: Path, quick: bool) -> None:
    """Write the map of the reconstructors: a panel for each dial, a line for each of them.

    A cell has the largest error of ΣFn of the frames that are read, in percent.
    """
    dials = list(dict.fromkeys(cell.dial for cell in results))
    readers = list(dict.fromkeys((cell.method, cell.design) for cell in results))
    columns = min(2, len(dials))
    rows = -(-len(dials) // columns)
    title = title_of("Domes, pressed and pulled to Γ ≈ .1: what each reconstructor reads", quick)
    figure = new_figure(title, WIDTH, rows * (0.24 * len(readers) + 0.65) + 1.4)
    panels = figure.subplots(rows, columns, squeeze=False)
    y = {reader: ", ".join(reader) for reader in readers}
    for axes, dial in zip(panels.flat, dials, strict=False):
        part = [cell for cell in results if cell.dial == dial]
        x = {cell.value: cell.value for cell in part}
        shown = {(c.value, (c.method, c.design)): (c.outcome, _text_of_force(c)) for c in part}
        draw_cells(axes, shown, x, y, OUTCOMES)
        axes.invert_yaxis()
        axes.set_xlabel(DIALS[dial].label, fontsize=8)
    for axes in panels.flat[len(dials) :]:
        axes.axis("off")
    for axes in panels[:, 1:].flat:
        axes.set_yticklabels([])
    numbers = remark("numbers: largest error of ΣFn in a frame that is read [%]")
    legend_below(figure, [*patches(results, OUTCOMES), numbers], 2)
    path.write_bytes(png(figure))


def _text_of_force(cell: ForceCell) -> str:
    error = cell.normal_percent
    number = "" if np.isnan(error) else f"{error:.0f}" if error >= 0.95 else "<1"
    return f"{OUTCOMES[cell.outcome].letter} {number}".strip()
