"""The summary of a run on the screen."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from .options import print_table, value_table

if TYPE_CHECKING:
    from ..loop.record import Result
    from ..loop.trace import Summary
    from ..scene.scene import Scene

#: Text of a value of the summary, by its name and a number of digits.
Number = Callable[..., str]


def print_summary(result: "Result", name: str) -> None:
    """Print the results of a run of a scene with that name."""
    from ..loop.results.expected_error import expected_words
    from ..loop.trace import reading_words

    summary, table = result.summary, value_table()

    def number(name: str, digits: int = 3) -> str:
        value = summary[name]
        return "–" if value is None else f"{value:z.{digits}f}"

    target = result.scene.target_margin
    table.add_row("scene", f"{name}, sensor {result.scene.sensor}")
    aim = "no target" if target is None else f"target {target:.2f}"
    table.add_row("controller", f"{summary['controller']}, {summary['path']} path, {aim}")
    rows = {"chain": _rows_of_one, "dome": _rows_of_one, "pinch": _rows_of_two}
    for name, words in rows[summary["mechanics"]](result.scene, summary, number):
        table.add_row(name, words)
    if (expected := summary.get("margin_error_expected")) is not None:
        table.add_row("error to expect", expected_words(expected, summary))
    table.add_row("speed", f"{number('frames_per_second', 1)} frames/s")
    if summary.get("reading_ms") is not None:
        table.add_row("time to read a frame", reading_words(summary))
    if result.folder is not None:
        table.add_row("folder", str(result.folder))
    print_table(table)


def _rows_of_one(scene: "Scene", summary: "Summary", number: Number) -> Iterator[tuple[str, str]]:
    from ..loop.trace import ceiling_words, word_for_read
    from ..render import load_sensor
    from ..sources.delivery import in_words
    from ..tracking.forces import pose_words

    read = word_for_read(summary["path"])
    yield (
        "safety margin at the end",
        f"{number('final_margin_true')} true, {number('final_margin_estimated')} {read}",
    )
    yield "smallest in the run", f"{number('smallest_margin_true')} true"
    torsion = {"chain": False, "dome": True}[summary["mechanics"]]
    if torsion:
        yield (
            "the same with torsion",
            f"{number('final_limit_margin_true')} true, "
            f"{number('final_limit_margin_estimated')} {read}; "
            f"the object turned by {number('final_turn_deg', 1)}°",
        )
    if summary.get("frames_skipped"):
        yield "frames left out", f"{summary['frames_skipped']}: the loop was too slow"
    if delivered := in_words(summary.get("delivery", {})):
        yield "frames of the source", delivered
    if summary["without_estimate"]:
        because = next(iter(summary["without_estimate_because"]))
        frames = f"{summary['without_estimate']} of {summary['frames']} frames"
        yield "no estimate in", f"{frames}, mostly: {because}"
    if summary["final_mu_true"] is not None:
        yield (
            "friction coefficient",
            f"{number('final_mu_true')} true, {number('final_mu_estimated')} {read} at the end",
        )
    yield "error of the margin, RMS", number("margin_rmse")
    if summary["camera_pose"] and summary["camera_pose"]["notable"]:
        yield "camera", pose_words(summary["camera_pose"])
    if summary["gross_slip"] is not None:  # which frames from outside do not tell
        yield (
            "lateral displacement",
            f"{number('lateral_displacement_mm')} mm, "
            f"{'gross slip' if summary['gross_slip'] else 'no gross slip'}",
        )
    for event in summary["slip_reactions"]:
        yield (
            "reacted to slip at",
            f"{event['time_s']:.3f} s, {event['lateral_displacement_mm']:.3f} mm",
        )
    markers = load_sensor(summary["sensor"]).markers
    if not torsion and (markers.swell_mm or markers.stretch):
        yield "mechanics", "those of the chain, not of this dome's silicone"
    yield "largest grip force", f"{number('max_grip_n')} N"
    if (words := ceiling_words(scene, summary)) is not None:
        yield "", words
    yield "largest pressure", f"{number('max_pressure_n_per_m', 0)} N/m"


def _rows_of_two(scene: "Scene", summary: "Summary", number: Number) -> Iterator[tuple[str, str]]:
    from ..loop.trace import ceiling_words

    mass, final = summary["mass_g"], summary["final_mass_g"]
    filled = "" if final in (None, mass) else f", {final:g} g at the end"
    stands = "" if summary["lifted"] else ", on the table at the end"
    if summary["outcome"] == "dropped":
        stands = f" at {summary['duration_s']:.2f} s, where the run ends"
        if not summary["left_table"]:
            stands = f": it slipped out of the grip before it left the table{stands}"
    yield "the object", f"{mass:g} g{filled}: {summary['outcome']}{stands}"
    yield (
        "smaller margin at the end",
        f"{number('final_margin_true')}, with torsion {number('final_limit_margin_true')}",
    )
    if summary["smallest_limit_margin_true"] is not None:
        smallest = number("smallest_limit_margin_true")
        yield "smallest as the hand lifts", f"{smallest} with torsion"
    yield "error of the margin, RMS", number("margin_rmse")
    if summary["without_estimate"]:
        because = next(iter(summary["without_estimate_because"]))
        yield "no estimate", f"{summary['without_estimate']} times, mostly: {because}"
    yield "slid by", f"{number('slide_mm', 2)} mm"
    yield (
        "turned by",
        f"{number('largest_turn_deg', 1)}° at most, and the skins by "
        f"{number('largest_elastic_deg', 1)}°",
    )
    yield "largest pressure", f"{number('max_pressure_kpa', 1)} kPa"
    yield "grip", f"{number('max_grip_n', 2)} N at most, {number('final_grip_n', 2)} N at the end"
    if (words := ceiling_words(scene, summary)) is not None:
        yield "", words
