"""The summary of a run on the screen."""

from typing import TYPE_CHECKING

from .options import print_table, value_table

if TYPE_CHECKING:
    from rich.table import Table

    from ..loop.record import Result
    from ..loop.trace import Summary


def print_summary(result: "Result") -> None:
    """Print what a run came to."""
    summary, table = result.summary, value_table()
    table.add_row("controller", f"{summary['controller']}, {summary['path']} path")
    add = _add_two if summary["mechanics"] == "pinch" else _add_one
    add(table, summary)
    table.add_row("speed", f"{_number(summary['frames_per_second'], 1)} frames/s")
    if result.folder is not None:
        table.add_row("folder", str(result.folder))
    print_table(table)


def _number(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else f"{value:z.{digits}f}"


def _add_one(table: "Table", summary: "Summary") -> None:
    """Rows of one finger."""
    from ..loop.trace import word_for_read
    from ..render import load_sensor
    from ..tracking.forces import pose_words

    read = word_for_read(summary["path"])
    table.add_row(
        "safety margin at the end",
        f"{_number(summary['final_margin_true'])} true, "
        f"{_number(summary['final_margin_estimated'])} {read}",
    )
    table.add_row("smallest in the run", f"{_number(summary['smallest_margin_true'])} true")
    if summary["mechanics"] == "dome":
        table.add_row(
            "the same with torsion",
            f"{_number(summary['final_limit_margin_true'])} true, "
            f"{_number(summary['final_limit_margin_estimated'])} {read}; "
            f"the object turned by {_number(summary['final_turn_deg'], 1)}°",
        )
    if summary.get("frames_skipped"):
        table.add_row("frames left out", f"{summary['frames_skipped']}: the loop was too slow")
    if summary["without_estimate"]:
        because = next(iter(summary["without_estimate_because"]))
        frames = f"{summary['without_estimate']} of {summary['frames']} frames"
        table.add_row("no estimate in", f"{frames}, mostly: {because}")
    table.add_row("error of the margin, RMS", _number(summary["margin_rmse"]))
    if summary["camera_pose"] and summary["camera_pose"]["notable"]:
        table.add_row("camera", pose_words(summary["camera_pose"]))
    if summary["gross_slip"] is not None:  # which frames from outside do not tell
        table.add_row(
            "lateral displacement",
            f"{_number(summary['lateral_displacement_mm'])} mm, "
            f"{'gross slip' if summary['gross_slip'] else 'no gross slip'}",
        )
    for event in summary["slip_reactions"]:
        table.add_row(
            "reacted to slip at",
            f"{event['time_s']:.3f} s, {event['lateral_displacement_mm']:.3f} mm",
        )
    markers = load_sensor(summary["sensor"]).markers
    if summary["mechanics"] == "chain" and (markers.swell_mm or markers.stretch):
        table.add_row("mechanics", "those of the chain, not of this dome's silicone")
    table.add_row("largest grip force", f"{_number(summary['max_grip_n'])} N")
    table.add_row("largest pressure", f"{_number(summary['max_pressure_n_per_m'], 0)} N/m")


def _add_two(table: "Table", summary: "Summary") -> None:
    """Rows of two fingers and what they hold."""

    def number(name: str, digits: int = 3) -> str:
        return _number(summary[name], digits)

    mass, final = summary["mass_g"], summary["final_mass_g"]
    filled = "" if final in (None, mass) else f", {final:g} g at the end"
    stands = "" if summary["lifted"] else ", on the table at the end"
    table.add_row("the object", f"{mass:g} g{filled}: {summary['outcome']}{stands}")
    table.add_row(
        "smaller margin at the end",
        f"{number('final_margin_true')}, with torsion {number('final_limit_margin_true')}",
    )
    if summary["smallest_limit_margin_true"] is not None:
        smallest = number("smallest_limit_margin_true")
        table.add_row("smallest while lifted", f"{smallest} with torsion")
    table.add_row("error of the margin, RMS", number("margin_rmse"))
    if summary["without_estimate"]:
        because = next(iter(summary["without_estimate_because"]))
        table.add_row("no estimate", f"{summary['without_estimate']} times, mostly: {because}")
    table.add_row("slid by", f"{number('slide_mm', 2)} mm")
    table.add_row(
        "turned by",
        f"{number('largest_turn_deg', 1)}° at most, and the skins by "
        f"{number('largest_elastic_deg', 1)}°",
    )
    table.add_row("largest pressure", f"{number('max_pressure_kpa', 1)} kPa")
    table.add_row(
        "grip", f"{number('max_grip_n', 2)} N at most, {number('final_grip_n', 2)} N at the end"
    )
