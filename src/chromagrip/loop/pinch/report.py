"""The report of a run folder of two fingers."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...output.run_page import Curve, Panel, RunOnPage, write_run_page
from ...scene.scene import Scene
from ..shown.report import (
    REPORT,
    RunRead,
    curves_there,
    doubt_words,
    early_words,
    estimate_words,
    estimated,
    facts_of,
    margin_panel,
    margin_words,
)
from ..shown.tactile_video import SLOWDOWN
from ..trace import may_slide, word_for_read
from .trace import FINGERS

Array = NDArray[np.float64]

#: Turn that a panel shows at least to both sides [°]: less is the solver's noise.
_TURN = 1.0
#: Values of a summary on the page: name, key, format, unit.
_FACTS = (
    ("controller", "controller", "", ""),
    ("path", "path", "", ""),
    ("sensors", "sensor", "", ""),
    ("seed of the noise", "seed", "", ""),
    ("outcome", "outcome", "", ""),
    ("mass", "final_mass_g", ".0f", "g"),
    ("smaller Γ at the end, true", "final_margin_true", ".3f", ""),
    ("the same with torsion", "final_limit_margin_true", ".3f", ""),
    ("smallest while lifted, with torsion", "smallest_limit_margin_true", ".3f", ""),
    ("error of Γ, RMS", "margin_rmse", ".3f", ""),
    ("slid by", "slide_mm", ".2f", "mm"),
    ("turned by, at most", "largest_turn_deg", ".1f", "°"),
    ("largest pressure", "max_pressure_kpa", ".0f", "kPa"),
    ("largest grip force", "max_grip_n", ".2f", "N"),
    ("grip force at the end", "final_grip_n", ".2f", "N"),
    ("frames", "frames", "", ""),
    ("speed of the loop", "frames_per_second", ".0f", "frames/s"),
)


def write_report(run: RunRead) -> None:
    """Write the report of a run of two fingers into its folder."""
    title = f"{run.scene.controller} with two fingers, {run.scene.path} path"
    write_run_page(run.folder / REPORT, [pinch_on_page(run, title)], title)


def pinch_on_page(run: RunRead, name: str) -> RunOnPage:
    """A run of two fingers as the page shows it, under a name."""
    return RunOnPage(
        name=name,
        time=run.columns["time_s"],
        panels=tuple(_panels(run.scene, run.columns)),
        words=tuple(_words(run.scene, run.summary, run.columns)),
        facts=tuple(facts_of(run.summary, _FACTS)),
        video=run.video,
        slowdown=SLOWDOWN,
        caption="The cameras' pictures with the tractions, and the object between the fingers.",
    )


def _panels(scene: Scene, of: dict[str, Array]) -> Iterator[Panel]:
    read = word_for_read(scene.path)
    for finger in FINGERS:
        yield margin_panel(scene, f"margins, {finger} finger", _margins(of, finger, read))
    yield Panel(
        title="friction ΣFf [N]",
        curves=_of_both(of, "friction", "_n", read),
    )
    yield Panel(
        title="grip and table [N]",
        curves=[
            Curve(label="grip of each finger", values=of["grip_n"], role="commanded", steps=True),
            Curve(label="force of the table", values=of["table_n"], role="other"),
        ],
    )
    yield Panel(
        title="friction coefficient µ",
        curves=_of_both(of, "mu", "", read),
        limits=(0.0, 2.0),
    )
    yield Panel(
        title="turn of the object [°], true",
        curves=[
            Curve(label="in the hand", values=of["turn_deg"], role="true"),
            Curve(label="elastic twist", values=of["elastic_deg"], role="true", second=True),
        ],
        span=(-_TURN, _TURN),
    )
    yield Panel(
        title="slid by [mm], true",
        curves=[Curve(label="in the hand", values=of["slide_mm"], role="true")],
    )
    yield Panel(
        title="mean pressure [kPa], true",
        curves=[Curve(label="of the contact pressed more", values=of["pressure_kpa"], role="true")],
    )


def _of_both(of: dict[str, Array], name: str, unit: str, read: str) -> tuple[Curve, ...]:
    """True and estimated value of that name of both fingers, with intervals where there are."""
    return curves_there(
        [
            Curve(
                label=f"{finger} finger, {word}",
                values=of[f"{finger}_{name}_{kind}{unit}"],
                role="true" if kind == "true" else "estimated",
                second=finger == FINGERS[1],
                low=of.get(f"{finger}_{name}_low") if kind == "estimated" else None,
                high=of.get(f"{finger}_{name}_high") if kind == "estimated" else None,
            )
            for finger in FINGERS
            for kind, word in (("true", "true"), ("estimated", read))
        ]
    )


def _margins(of: dict[str, Array], finger: str, read: str) -> list[Curve]:
    return [
        Curve(label="Γ, true", values=of[f"{finger}_margin_true"], role="true", second=True),
        estimated(of, f"{finger}_margin", f"Γ, {read}", second=True),
        Curve(label="with torsion, true", values=of[f"{finger}_limit_margin_true"], role="true"),
        Curve(
            label=f"with torsion, {read}",
            values=of[f"{finger}_limit_margin_estimated"],
            role="estimated",
        ),
    ]


def _words(scene: Scene, summary: dict[str, Any], of: dict[str, Array]) -> Iterator[str]:
    """What happened, in sentences."""
    yield from early_words(scene, summary)
    pinch = scene.pinch
    bounds = f"{pinch.turned_deg:g}° count as turned and {pinch.dropped_mm:g} mm as dropped"
    if pinch.crushed_kpa:
        bounds += f", {pinch.crushed_kpa:g} kPa as crushed"
    yield (
        f"{str(summary['outcome']).capitalize()}: the object turned by up to "
        f"{summary['largest_turn_deg']:.1f}° and slid by {summary['slide_mm']:.2f} mm, under up to "
        f"{summary['max_pressure_kpa']:.0f} kPa; {bounds}."
    )
    if not summary["lifted"]:
        yield "The table still bore a part of the weight at the end."
    name = "The smaller margin, with torsion,"
    yield margin_words(scene, name, summary["final_limit_margin_true"], None)
    either = [may_slide(scene, of, f"{finger}_") for finger in FINGERS]
    yield from doubt_words(scene, float(np.mean(np.any(either, axis=0))))
    yield from estimate_words(summary, 2 * summary["frames"])
