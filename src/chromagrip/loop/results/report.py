"""The report of a run folder: a page with a time slider."""

from collections.abc import Iterator

import numpy as np

from ...model import GROSS_SLIP
from ...output.run_page import RunOnPage, write_run_page
from ...scene.scene import PathName, Scene
from ..columns import prefixes
from ..trace import Summary, ceiling_words, may_slide, reading_words, word_for_read
from .expected_error import expected_words
from .panels import Columns, panels_of
from .run_folder import RunRead
from .tactile_video import SLOWDOWN

#: Name of the report in a run folder.
REPORT = "report.html"
_PINCHED = "The cameras' pictures with the tractions, and the object between the fingers."
_CAPTIONS: dict[int, dict[PathName, str]] = {
    1: {
        "camera": ("Left: the camera's picture. Right: the estimated contact, and the true one."),
        "truth": "Left: the camera's picture. Right: the true contact.",
    },
    2: {"camera": _PINCHED, "truth": _PINCHED},
}


def write_report(run: RunRead) -> None:
    """Write the report of a run into its folder."""
    # By the number of fingers: end of the title, and what the video shows on each path.
    titles = {1: "", 2: " with two fingers"}
    title = f"{run.scene.controller}{titles[run.scene.fingers]}, {run.scene.path} path"
    write_run_page(run.folder / REPORT, [run_on_page(run, title)], title)


def run_on_page(run: RunRead, name: str) -> RunOnPage:
    """Prepare a run for the page, under a name."""
    return RunOnPage(
        name=name,
        time=run.columns["time_s"],
        panels=tuple(panels_of(run.scene, run.columns)),
        words=tuple(_words(run.scene, run.summary, run.columns)),
        facts=tuple(_facts(run.scene, run.summary)),
        video=run.video,
        slowdown=SLOWDOWN,
        caption=_caption(run.scene),
        scene=run.scene.description or f"a scene of body {run.scene.mechanics}",
    )


def _caption(scene: Scene) -> str:
    """Caption of the video."""
    return _CAPTIONS[scene.fingers][scene.path]


def _words(scene: Scene, summary: Summary, of: Columns) -> Iterator[str]:
    """Describe the run in sentences."""
    if not summary["complete"]:
        yield f"The run ended early, at {summary['duration_s']:.2f} s of {scene.duration_s:g} s."
    yield from {1: _one_words, 2: _two_words}[scene.fingers](scene, summary, of)
    if (expected := summary.get("margin_error_expected")) is not None:
        words = expected_words(expected, summary)
        yield f"Error of Γ to expect of this sensor and reader: {words}."
        if summary.get("reconstructor") == "contact":
            yield (
                "µ is seen only where the object slides or is about to: before that its estimate "
                "is near the usual value of 0.5, with a wide interval, whatever the object is."
            )
    possible = np.any([may_slide(scene, of, before) for before in prefixes(scene)], axis=0)
    if scene.sliding_margin is not None and possible.any():
        yield (
            f"In {_share(float(np.mean(possible)))} of the frames the interval of the margin "
            f"reached down to {scene.sliding_margin:g}: the object might have slid, so the grip "
            "was held or raised (Grip First)."
        )
    if summary["without_estimate"]:
        because = next(iter(summary["without_estimate_because"]))
        frames = len(prefixes(scene)) * summary["frames"]
        yield (
            f"No forces were estimated in {summary['without_estimate']} of {frames} frames, "
            f"mostly because: {because}."
        )


def _share(share: float) -> str:
    """Share above 0 in words."""
    return f"{100 * share:.0f} %" if share >= 0.01 else "under 1 %"


def _one_words(scene: Scene, summary: Summary, of: Columns) -> Iterator[str]:
    """Slip and margin of one finger."""
    way, limit = summary["lateral_displacement_mm"], 1e3 * GROSS_SLIP
    if summary["gross_slip"] is None or way is None:
        yield "Frames from outside do not show whether the object slid."
    elif summary["gross_slip"]:
        yield f"Gross slip: the object slid by {way:.2f} mm, more than {limit:g} mm."
    else:
        yield f"Held: the object slid by {way:.3f} mm; from {limit:g} mm on it is gross slip."
    true, estimate = summary["final_margin_true"], summary["final_margin_estimated"]
    yield _margin_words(scene, "Γ", true, estimate)
    margin = of["margin_true"]
    if np.isfinite(margin).any():
        at = int(np.nanargmin(margin))
        yield f"The smallest true Γ was {margin[at]:.2f}, at {of['time_s'][at]:.2f} s."
    known = scene.target_margin is not None and true is not None and estimate is not None
    notable = 0.03  # error of Γ at the end above which the page explains it
    if known and abs(true - estimate) > notable:
        low, high = of["margin_low"][-1], of["margin_high"][-1]
        where = "within" if low <= true <= high else "outside"
        yield (
            f"The controller holds the estimate, which is {abs(true - estimate):.2f} too "
            f"{'high' if estimate > true else 'low'}; the truth is {where} its 90 % interval, "
            f"{low:.2f} to {high:.2f}."
        )


def _two_words(scene: Scene, summary: Summary, of: Columns) -> Iterator[str]:
    """Outcome and margin of two fingers."""
    pinch = scene.pinch
    bounds = f"{pinch.turned_deg:g}° count as turned and {pinch.dropped_mm:g} mm as dropped"
    if pinch.crushed_kpa:
        bounds += f", {pinch.crushed_kpa:g} kPa as crushed"
    yield (
        f"{str(summary['outcome']).capitalize()}: the object turned by up to "
        f"{summary['largest_turn_deg']:.1f}° and slid by {summary['slide_mm']:.2f} mm, under up to "
        f"{summary['max_pressure_kpa']:.0f} kPa; {bounds}."
    )
    if summary["outcome"] == "dropped":
        yield f"It was dropped at {summary['duration_s']:.2f} s, where the run ends."
        if summary.get("left_table") is False:
            yield "It slipped out of the grip before it left the table."
    elif not summary["lifted"]:
        yield "The table still carried a part of the weight at the end."
    if (words := ceiling_words(scene, summary)) is not None:
        yield f"At the end the grip was {summary['final_grip_n']:g} N, {words}."
    name = "The smaller margin, with torsion,"
    yield _margin_words(scene, name, summary["final_limit_margin_true"], None)


def _margin_words(scene: Scene, name: str, true: float | None, estimated: float | None) -> str:
    """Describe a margin at the end, and its target."""
    target = scene.target_margin
    values = [
        f"{value:.2f} {kind}"
        for value, kind in ((true, "in truth"), (estimated, f"as {word_for_read(scene.path)}"))
        if value is not None
    ]
    ended = f"{name} ended at {', '.join(values)}" if values else f"{name} is not known at the end"
    aim = "the controller has no target" if target is None else f"the target is {target:.2f}"
    return f"{ended}; {aim}."


#: Values of a summary on the page: name, key, format, unit.
_FACTS = (
    ("controller", "controller", "", ""),
    ("path", "path", "", ""),
    ("body", "mechanics", "", ""),
    ("sensor", "sensor", "", ""),
    ("second sensor", "second_sensor", "", ""),
    ("forces read by", "reconstructor", "", ""),
    ("seed of the noise", "seed", "", ""),
    ("outcome", "outcome", "", ""),
    ("mass", "final_mass_g", ".0f", "g"),
    ("{smaller}Γ at the end, true", "final_margin_true", ".3f", ""),
    ("Γ at the end, {read}", "final_margin_estimated", ".3f", ""),
    ("smallest Γ, true", "smallest_margin_true", ".3f", ""),
    ("error of Γ, RMS", "margin_rmse", ".3f", ""),
    ("{smaller}margin with torsion at the end, true", "final_limit_margin_true", ".3f", ""),
    ("smallest with torsion as the hand lifts, true", "smallest_limit_margin_true", ".3f", ""),
    ("µ at the end, true", "final_mu_true", ".3f", ""),
    ("µ at the end, {read}", "final_mu_estimated", ".3f", ""),
    ("lateral displacement", "lateral_displacement_mm", ".3f", "mm"),
    ("rigid slip", "rigid_slip_mm", ".3f", "mm"),
    ("slid by", "slide_mm", ".2f", "mm"),
    ("turned by, at most", "largest_turn_deg", ".1f", "°"),
    ("largest grip force", "max_grip_n", ".2f", "N"),
    ("grip force at the end", "final_grip_n", ".2f", "N"),
    ("largest pressure", "max_pressure_n_per_m", ".0f", "N/m"),
    ("largest mean pressure", "max_pressure_kpa", ".0f", "kPa"),
    ("frames", "frames", "", ""),
    ("readings without an estimate", "without_estimate", "", ""),
    ("speed of the loop", "frames_per_second", ".0f", "frames/s"),
)


def _facts(scene: Scene, summary: Summary) -> Iterator[tuple[str, str]]:
    """Names and values for a table; unknown values are left out."""
    read, smaller = word_for_read(scene.path), {1: "", 2: "smaller "}[scene.fingers]
    for name, key, form, unit in _FACTS:
        value = summary.get(key)
        if value is not None:
            yield name.format(read=read, smaller=smaller), f"{value:{form}} {unit}".strip()
    if summary.get("reading_ms") is not None:
        yield "time to read a frame", reading_words(summary)
