"""The command `limit`: the smallest errors that a picture of a sensor allows."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from ..errors import UserError, located
from ..scene.scene import Body
from .options import JsonOnly, Overwrite, option, status

if TYPE_CHECKING:
    from ..measure.limits.body import BodyLimit
    from ..measure.limits.sweep import Point


def limit(
    *,
    sensor: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option(
            "sensor design; by default thesis, or every dome with --body dome; may be repeated",
            "NAME|FILE.toml",
        ),
    ] = (),
    body: Annotated[
        Body, option("fingertip: node chain, or dome of silicone in 3D", "chain|dome")
    ] = "chain",
    grip: Annotated[
        float | None, option("grip force in N; by default 1.86 N, or 3 N for a dome", "N")
    ] = None,
    load: Annotated[
        float | None,
        option(
            "lateral load in N, raised after the grip; by default 0.65 N, or for a dome that of "
            "Γ = 0.3",
            "N",
        ),
    ] = None,
    azimuth_deg: Annotated[
        float | None, option("direction of a dome's load in °, from the picture's x", "DEG")
    ] = None,
    shears: Annotated[
        int | None,
        option("number of pictures of a dome's shear that are read together; by default 3", "N"),
    ] = None,
    friction: Annotated[float, option("friction coefficient µ of the object", "MU")] = 0.5,
    radius_mm: Annotated[float, option("radius of the object in mm; inf is flat", "MM")] = math.inf,
    stiffness_kpa: Annotated[float, option("Young's modulus of the object in kPa", "KPA")] = 200.0,
    noise: Annotated[
        float, option("standard deviation of the camera noise in levels of 0 to 255", "LEVELS")
    ] = 2.0,
    frames: Annotated[int, option("number of frames averaged under load; 16 at rest", "N")] = 1,
    margin_error: Annotated[
        float | None, option("error of Γ for which the needs of a design are printed", "GAMMA")
    ] = None,
    out: Annotated[
        Path | None, option("folder for a chart and its table; by default no files", "DIR")
    ] = None,
    overwrite: Overwrite = False,
    json_only: JsonOnly = False,
) -> int:
    """Compute the smallest errors of ΣFn, ΣFf, µ and Γ that a picture of a sensor allows.

    They are the errors of the best estimate from one picture at one pose, without knowledge of the
    object and its history. `docs/what-the-image-tells.md` lists the known quantities. For a dome of
    silicone they belong to a contact that is fitted to some pictures, and to free tractions.

    Example: chromagrip limit --sensor thesis --sensor fovea --margin-error 0.03
    """
    above = {
        "--grip": (grip, "N"),
        "--noise": (noise, "levels"),
        "--margin-error": (margin_error, ""),
    }
    for name, (value, unit) in above.items():
        if value is not None and not 0.0 < value < math.inf:
            given = f"{value:g} {unit}".strip()
            raise UserError(f"{name} must be finite and above 0, got {given}")
    if frames < 1:
        raise UserError(f"--frames must be 1 or more, got {frames}")
    # Options that some bodies alone have.
    options = {"chain": (), "dome": ("--azimuth-deg", "--shears")}
    for name, value in (("--azimuth-deg", azimuth_deg), ("--shears", shears)):
        if value is not None and name not in options[body]:
            raise UserError(f"{name} needs --body dome")

    from ..folders import prepared
    from ..measure.limits.body import Case  # Numba and matplotlib load only here
    from ..measure.limits.chain import ChainLimit
    from ..measure.limits.dome.report import DomeLimit
    from ..measure.limits.sweep import draw, write_table

    bodies: dict[Body, type[BodyLimit]] = {"chain": ChainLimit, "dome": DomeLimit}
    kind = bodies[body]
    pressed, (force, share) = kind.GRIP if grip is None else grip, kind.LOAD
    case = Case(
        body=body,
        grip_n=pressed,
        load_n=force + share * friction * pressed if load is None else load,
        azimuth_deg=azimuth_deg or 0.0,
        friction=friction,
        radius_mm=radius_mm,
        stiffness_kpa=stiffness_kpa,
        shears=3 if shears is None else shears,
        noise_levels=noise,
        frames=frames,
        margin_error=margin_error,
    )
    names = dict.fromkeys(sensor or kind.default_designs())
    limits = {name: kind.of(case, name) for name in names}
    with prepared(out, overwrite):
        entries, sweeps = _compute(limits, margin_error, out is not None)
        report = {**case.entries(), "sensors": entries}
        if out is not None:
            draw(limits, sweeps, case.title, out / "limit.png")
            write_table(limits, sweeps, out / "limit.csv")
            (out / "limit.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    if json_only:
        print(json.dumps(report))
        return 0
    print(case.title)
    _print_limits(kind, entries)
    if margin_error is not None:
        _print_needs(kind, entries, margin_error)
    if out is not None:
        print(f"folder {out}, see {out / 'limit.png'}")
    return 0


def _compute(
    limits: Mapping[str, "BodyLimit"], wanted: float | None, drawn: bool
) -> tuple[dict[str, dict[str, Any]], dict[str, "list[Point]"]]:
    """Entry of each design, and where they are needed the limits of designs that differ from it."""
    from ..measure.limits.sweep import needed, sweep

    entries, sweeps = {}, {}
    with status("limits") as show:
        for name, limit in limits.items():

            def tell(text: str, name: str = name) -> None:
                show(f"{name}: {text}")

            with located(f"sensor {name}"):
                tell("limits")
                try:
                    entries[name] = limit.entry()
                except np.linalg.LinAlgError:
                    raise UserError(
                        "markers do not determine forces at this grip and load: give less of them"
                    ) from None
                if drawn or wanted is not None:
                    points = sweeps[name] = sweep(limit, progress=tell)
                if wanted is not None:
                    entries[name]["needed"] = {
                        dial: needed([p for p in points if p.dial == dial], wanted, limit.NEAREST)
                        for dial in limit.DIALS
                    }
    return entries, sweeps


def _print_limits(kind: "type[BodyLimit]", entries: Mapping[str, dict[str, Any]]) -> None:
    """Print the smallest deviations, a block for each design."""
    headings = "".join(f"{heading:>10}" for _, heading, _ in kind.COLUMNS)
    print(f"{'smallest standard deviation of':<44}{headings}")
    for name, entry in entries.items():
        heading, rows = kind.words(entry)
        print(f"{name}: {heading}")
        for label, found in rows.items():
            cells = (_short(found.get(key), factor) for key, _, factor in kind.COLUMNS)
            print(f"  {label:<42}" + "".join(f"{cell:>10}" for cell in cells))


def _short(value: float | None, factor: float) -> str:
    """Three digits; `–` where the value is unknown."""
    if value is None:
        return "–"
    return f"{factor * value:.0f}" if factor * value >= 1000.0 else f"{factor * value:.3g}"


def _print_needs(
    kind: "type[BodyLimit]", entries: Mapping[str, dict[str, Any]], wanted: float
) -> None:
    """Print the value of each dial that the wanted error of Γ needs, a column for each design."""
    from ..measure.limits.dials import DIALS

    width = max(14, 2 + max(map(len, entries)))
    print(f"for an error of Γ of {wanted:g}{kind.NEEDS}:")
    print(" " * 42 + "".join(f"{name:>{width}}" for name in entries))
    for dial in kind.DIALS:
        bound = "" if kind.NEAREST else ", at most" if dial == "noise" else ", at least"
        needs = [entry["needed"][dial] for entry in entries.values()]
        row = "".join(f"{'unreachable' if n is None else f'{n:.3g}':>{width}}" for n in needs)
        print(f"{DIALS[dial].axis + bound:<42}{row}")
