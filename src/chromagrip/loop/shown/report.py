"""The report of a run folder of one finger: a page with a time slider."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...extras import need
from ...model import GROSS_SLIP
from ...output.run_page import Curve, Panel, RunOnPage, write_run_page
from ...scene.scene import Scene, load_scene
from ...tracking import Z90
from ..trace import may_slide, word_for_read
from .tactile_video import SLOWDOWN

Array = NDArray[np.float64]

#: Name of the report in a run folder.
REPORT = "report.html"
#: Margins that a panel shows at most.
MARGINS = (-0.2, 1.05)
#: Error of Γ at the end from which on the page says more about it.
_NOTABLE = 0.03
#: Largest µ that a panel shows.
_LARGEST_FRICTION = 2.0


@dataclass(frozen=True, kw_only=True)
class RunRead:
    """What a run folder holds.

    Attributes
    ----------
    folder: read
    scene: that was run
    summary: of the run
    columns: of its trace
    """

    folder: Path
    scene: Scene
    summary: dict[str, Any]
    columns: dict[str, Array]

    @property
    def video(self) -> Path | None:
        """Its video; None where there is none."""
        path = self.folder / "tactile.mp4"
        return path if path.is_file() else None


def read_run(folder: Path) -> RunRead:
    """Read a run folder.

    Raises
    ------
    UserError
        When it is none, or a file of it cannot be read.
    """
    if not folder.is_dir():
        raise UserError(f"{folder} is not a run folder: there is no such folder")
    for name in ("summary.json", "trace.parquet", "scene.toml"):
        if not (folder / name).is_file():
            raise UserError(f"{folder} is not a finished run: it has no {name}")
    pq = need("pyarrow.parquet", "data")
    try:
        summary = msgspec.json.decode((folder / "summary.json").read_bytes(), type=dict[str, Any])
        table = pq.read_table(folder / "trace.parquet")
    except (OSError, ValueError) as error:  # of msgspec and of Arrow too
        raise UserError(f"{folder} cannot be read: {error}") from None
    columns = {name: table[name].to_numpy().astype(float) for name in table.column_names}
    scene = load_scene(str(folder / "scene.toml"))
    return RunRead(folder=folder, scene=scene, summary=summary, columns=columns)


def write_report(run: RunRead) -> None:
    """Write the report of a run of one finger into its folder."""
    title = f"{run.scene.controller}, {run.scene.path} path"
    write_run_page(run.folder / REPORT, [run_on_page(run, title)], title)


def run_on_page(run: RunRead, name: str) -> RunOnPage:
    """A run of one finger as the page shows it, under a name."""
    return RunOnPage(
        name=name,
        time=run.columns["time_s"],
        panels=tuple(_panels(run.scene, run.columns)),
        words=tuple(_words(run.scene, run.summary, run.columns)),
        facts=tuple(
            (name.replace("estimated", word_for_read(run.scene.path)), value)
            for name, value in facts_of(run.summary, _FACTS)
        ),
        video=run.video,
        slowdown=SLOWDOWN,
        caption="Left: the camera's picture. Right: the contact as it was estimated, and as it is."
        if run.scene.path == "camera"
        else "Left: the camera's picture. Right: the true contact.",
    )


def curves_there(curves: Sequence[Curve]) -> tuple[Curve, ...]:
    """Those of the curves that have a value."""
    return tuple(curve for curve in curves if np.isfinite(curve.values).any())


def estimated(
    of: dict[str, Array], name: str, label: str = "estimated", second: bool = False
) -> Curve:
    """Estimate of that name with the ends of its 90 % interval, which have columns of their own."""
    return Curve(
        label=label,
        values=of[f"{name}_estimated"],
        role="estimated",
        second=second,
        low=of[f"{name}_low"],
        high=of[f"{name}_high"],
    )


def _panels(scene: Scene, of: dict[str, Array]) -> Iterator[Panel]:
    """Panels of a trace's columns, without those that have no value."""
    read = word_for_read(scene.path)
    sums = [
        *_with_deviation(of, "normal", read, "ΣFn"),
        *_with_deviation(of, "friction", read, "ΣFf", True),
    ]
    torques = _with_deviation(of, "torque", read, unit="nmm") if "torque_true_nmm" in of else []
    panels = (
        margin_panel(scene, "safety margin Γ", _margins(of, read)),
        Panel(title="contact forces [N]", curves=curves_there(sums)),
        Panel(title="grip and load [N]", curves=curves_there(_drives(of))),
        Panel(
            title="friction coefficient µ",
            curves=curves_there(_frictions(of, read)),
            limits=(0.0, _LARGEST_FRICTION),
        ),
        Panel(
            title="slip of the object [mm], true",
            curves=curves_there(_slips(of)),
            levels=((f"gross slip {1e3 * GROSS_SLIP:g}", 1e3 * GROSS_SLIP),),
        ),
        Panel(title="pressure [N/m], true", curves=curves_there(_pressures(of))),
        Panel(title="torque about the axis [N mm]", curves=curves_there(torques)),
    )
    yield from (panel for panel in panels if panel.curves)


def margin_panel(scene: Scene, title: str, curves: Sequence[Curve]) -> Panel:
    """Panel of margins, with the target of the controller."""
    levels = (
        ("target {:g}", scene.target_margin),
        ("sliding possible from {:g} down", scene.sliding_margin),
    )
    return Panel(
        title=title,
        curves=curves_there(curves),
        levels=tuple((text.format(value), value) for text, value in levels if value is not None),
        span=(0.0, 1.0),
        limits=MARGINS,
    )


def _drives(of: dict[str, Array]) -> list[Curve]:
    return [
        Curve(label="grip commanded", values=of["grip_n"], role="commanded", steps=True),
        Curve(label="grip applied", values=of["applied_n"], role="commanded", second=True),
        Curve(label="load", values=of["load_n"], role="other", steps=True),
    ]


def _frictions(of: dict[str, Array], read: str) -> list[Curve]:
    return [Curve(label="true", values=of["mu_true"], role="true"), estimated(of, "mu", read)]


def _slips(of: dict[str, Array]) -> list[Curve]:
    return [
        Curve(label="lateral displacement", values=of["lateral_displacement_mm"], role="true"),
        Curve(label="rigid slip", values=of["rigid_slip_mm"], role="true", second=True),
    ]


def _pressures(of: dict[str, Array]) -> list[Curve]:
    return [
        Curve(label="over the outermost nodes", values=of["pressure_n_per_m"], role="true"),
        Curve(
            label="plus one node pitch",
            values=of["pressure_pitch_n_per_m"],
            role="true",
            second=True,
        ),
    ]


def _margins(of: dict[str, Array], read: str) -> list[Curve]:
    """Γ, and on a dome the margin of force and torsion together."""
    curves = [
        Curve(label="true", values=of["margin_true"], role="true"),
        estimated(of, "margin", read),
    ]
    if "limit_margin_estimated" in of:
        curves += [
            Curve(
                label=f"with torsion, {word}",
                values=of[f"limit_margin_{name}"],
                role="true" if name == "true" else "estimated",
                second=True,
            )
            for name, word in (("true", "true"), ("estimated", read))
        ]
    return curves


def _with_deviation(
    of: dict[str, Array],
    name: str,
    read: str,
    label: str = "",
    second: bool = False,
    unit: str = "n",
) -> list[Curve]:
    """True and estimated value of that name, the latter with its 90 % interval."""
    value, spread = of[f"{name}_estimated_{unit}"], Z90 * of[f"{name}_deviation_{unit}"]
    return [
        Curve(
            label=f"{label} true".strip(),
            values=of[f"{name}_true_{unit}"],
            role="true",
            second=second,
        ),
        Curve(
            label=f"{label} {read}".strip(),
            values=value,
            role="estimated",
            second=second,
            low=value - spread,
            high=value + spread,
        ),
    ]


def doubt_words(scene: Scene, share: float) -> Iterator[str]:
    """Why the grip is more than the target asks for, where it is.

    Parameters
    ----------
    scene: that was run
    share: of the frames in which sliding was possible
    """
    if scene.sliding_margin is not None and share > 0.0:
        yield (
            f"In {100 * share:.0f} % of the frames the interval of the margin reached down to "
            f"{scene.sliding_margin:g}: the object might have slid, so the grip was held or raised "
            "(Grip First)."
        )


def _words(scene: Scene, summary: dict[str, Any], of: dict[str, Array]) -> Iterator[str]:
    """What happened, in sentences."""
    yield from early_words(scene, summary)
    way, limit = summary["lateral_displacement_mm"], 1e3 * GROSS_SLIP
    if summary["gross_slip"] is None or way is None:
        yield "Frames from outside do not tell whether the object slid."
    elif summary["gross_slip"]:
        yield f"Gross slip: the object slid by {way:.2f} mm, more than {limit:g} mm."
    else:
        yield f"Held: the object slid by {way:.3f} mm; from {limit:g} mm on it is gross slip."
    true, estimate = summary["final_margin_true"], summary["final_margin_estimated"]
    yield margin_words(scene, "Γ", true, estimate)
    yield from smallest_words(of["time_s"], of["margin_true"])
    known = scene.target_margin is not None and true is not None and estimate is not None
    if known and abs(true - estimate) > _NOTABLE:
        low, high = of["margin_low"][-1], of["margin_high"][-1]
        where = "within" if low <= true <= high else "outside"
        yield (
            f"The controller holds the estimate, which is {abs(true - estimate):.2f} too "
            f"{'high' if estimate > true else 'low'}; the truth is {where} its 90 % interval, "
            f"{low:.2f} to {high:.2f}."
        )
    yield from doubt_words(scene, float(np.mean(may_slide(scene, of))))
    yield from estimate_words(summary, summary["frames"])


def early_words(scene: Scene, summary: dict[str, Any]) -> Iterator[str]:
    """That a run ended before its scene, where it did."""
    if not summary["complete"]:
        yield f"The run ended early, at {summary['duration_s']:.2f} s of {scene.duration_s:g} s."


def margin_words(scene: Scene, name: str, true: float | None, estimated: float | None) -> str:
    """Where a margin ended, and what it should have been."""
    target = scene.target_margin
    values = [
        f"{value:.2f} {kind}"
        for value, kind in ((true, "in truth"), (estimated, f"as {word_for_read(scene.path)}"))
        if value is not None
    ]
    ended = f"{name} ended at {', '.join(values)}" if values else f"{name} is not known at the end"
    aim = "the controller has no target" if target is None else f"the target is {target:.2f}"
    return f"{ended}; {aim}."


def smallest_words(time: Array, margin: Array) -> Iterator[str]:
    """Where the object was nearest to slipping."""
    if np.isfinite(margin).any():
        at = int(np.nanargmin(margin))
        yield f"The smallest true Γ was {margin[at]:.2f}, at {time[at]:.2f} s."


def estimate_words(summary: dict[str, Any], frames: int) -> Iterator[str]:
    """How often no forces could be estimated, and why."""
    if summary["without_estimate"]:
        because = next(iter(summary["without_estimate_because"]))
        yield (
            f"No forces were estimated in {summary['without_estimate']} of {frames} frames, "
            f"mostly because: {because}."
        )


#: Values of a summary on the page: name, key, format, unit.
_FACTS = (
    ("controller", "controller", "", ""),
    ("path", "path", "", ""),
    ("body", "mechanics", "", ""),
    ("sensor", "sensor", "", ""),
    ("forces read by", "reconstructor", "", ""),
    ("seed of the noise", "seed", "", ""),
    ("Γ at the end, true", "final_margin_true", ".3f", ""),
    ("Γ at the end, estimated", "final_margin_estimated", ".3f", ""),
    ("smallest Γ, true", "smallest_margin_true", ".3f", ""),
    ("error of Γ, RMS", "margin_rmse", ".3f", ""),
    ("margin with torsion at the end, true", "final_limit_margin_true", ".3f", ""),
    ("µ at the end, true", "final_mu_true", ".3f", ""),
    ("µ at the end, estimated", "final_mu_estimated", ".3f", ""),
    ("lateral displacement", "lateral_displacement_mm", ".3f", "mm"),
    ("rigid slip", "rigid_slip_mm", ".3f", "mm"),
    ("largest grip force", "max_grip_n", ".2f", "N"),
    ("grip force at the end", "final_grip_n", ".2f", "N"),
    ("largest pressure", "max_pressure_n_per_m", ".0f", "N/m"),
    ("frames", "frames", "", ""),
    ("frames without an estimate", "without_estimate", "", ""),
    ("speed of the loop", "frames_per_second", ".0f", "frames/s"),
)


def facts_of(
    summary: dict[str, Any], rows: Sequence[tuple[str, str, str, str]]
) -> Iterator[tuple[str, str]]:
    """Names and values for a table; unknown values are left out."""
    for name, key, form, unit in rows:
        value = summary.get(key)
        if value is not None:
            yield name, f"{value:{form}} {unit}".strip()
