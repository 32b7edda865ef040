"""The part of the command `limit` that is about domes of silicone."""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import UserError, located
from ..render import SensorDesign, load_sensor, sensor_names
from .options import status

if TYPE_CHECKING:
    from ..measure.limits.dome.held import Grip
    from ..measure.limits.dome.report import DomeLimit
    from ..measure.limits.dome.sweep import DomePoint

#: Columns of the printed table: attribute, heading, and factor to the heading's unit.
COLUMNS = (
    ("x", "F_x mN", 1e3),
    ("y", "F_y mN", 1e3),
    ("normal", "F_n mN", 1e3),
    ("moment", "M_z µN·m", 1e6),
    ("mu", "µ", 1.0),
    ("margin", "Γ", 1.0),
)
#: Load of a dome by default, over µ and the grip.
DOME_LOAD = 0.7
#: Largest number of pictures of a shear.
_MOST = 20


@dataclass(frozen=True, kw_only=True)
class DomeCase:
    """Contact and camera whose limits are computed; units as in the command's options."""

    grip_n: float
    load_n: float
    azimuth_deg: float
    friction: float
    radius_mm: float
    stiffness_kpa: float
    shears: int
    noise_levels: float
    frames: int
    margin_error: float | None

    @property
    def title(self) -> str:
        """The case in one line."""
        form = "flat" if math.isinf(self.radius_mm) else f"of radius {self.radius_mm:g} mm"
        return (
            f"Dome: grip {self.grip_n:g} N, load {self.load_n:g} N at {self.azimuth_deg:g}°, "
            f"µ {self.friction:g}, object {form}, {self.stiffness_kpa:g} kPa; pictures of the "
            f"press: 1, of the shear: {self.shears}; noise {self.noise_levels:g} levels, frames "
            f"averaged: {self.frames}"
        )

    def grip(self) -> "Grip":
        """The contact."""
        from ..measure.limits.dome.held import Grip

        return Grip(
            normal=self.grip_n,
            load=self.load_n,
            azimuth=math.radians(self.azimuth_deg),
            friction=self.friction,
            radius=1e-3 * self.radius_mm,
            young=1e3 * self.stiffness_kpa,
            shears=self.shears,
        )


def check(case: DomeCase) -> None:
    """Refuse what cannot be.

    Raises
    ------
    UserError
        With the option, its value and what is allowed.
    """
    for name, value in (
        ("--friction", case.friction),
        ("--radius-mm", case.radius_mm),
        ("--stiffness-kpa", case.stiffness_kpa),
    ):
        if not value > 0.0:
            raise UserError(f"{name} must be above 0, got {value:g}")
    if not math.isfinite(case.azimuth_deg):
        raise UserError(f"--azimuth-deg must be finite, got {case.azimuth_deg:g}")
    if not 1 <= case.shears <= _MOST:
        raise UserError(f"--shears must be 1 to {_MOST}, got {case.shears}")


def dome_sensors(names: tuple[str, ...]) -> dict[str, SensorDesign]:
    """The named designs; without names all shipped ones with a dome of silicone.

    Raises
    ------
    UserError
        For a design that has no such limits.
    """
    from ..measure.limits.dome.report import dome_of

    if not names:
        every = {name: load_sensor(name) for name in sensor_names()}
        return {n: s for n, s in every.items() if not s.shape.flat and s.silicone is not None}
    named = {name: load_sensor(name) for name in dict.fromkeys(names)}
    for name, sensor in named.items():
        with located(f"sensor {name}"):
            dome_of(sensor)
    return named


def print_dome_limits(
    case: DomeCase, names: tuple[str, ...], out: Path | None, overwrite: bool, json_only: bool
) -> None:
    """Compute, print and, with a folder, write the limits of designs."""
    from ..output.folder import prepare

    check(case)
    sensors = dome_sensors(names)
    if out is not None:
        prepare(out, overwrite)
    limits, sweeps = _compute(case, sensors, out is not None or case.margin_error is not None)
    report = _report(case, limits, sweeps)
    if out is not None:
        from ..measure.limits.dome.sweep import draw_dome, write_dome_table

        draw_dome(sweeps, case.title, out / "limit.png")
        write_dome_table(sweeps, out / "limit.csv")
        (out / "limit.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    if json_only:
        print(json.dumps(report))
        return
    print(case.title)
    _print_limits(limits)
    if case.margin_error is not None:
        _print_needs(report["sensors"], case.margin_error)
    if out is not None:
        print(f"folder {out}, see {out / 'limit.png'}")


def _compute(
    case: DomeCase, sensors: dict[str, SensorDesign], swept: bool
) -> tuple[dict[str, "DomeLimit"], dict[str, "list[DomePoint]"]]:
    """Limits of each design, and with `swept` those of designs that differ from it."""
    from ..measure.limits.dome.report import dome_limit, noise_models
    from ..measure.limits.dome.sweep import sweep_dome

    noises = noise_models(case.noise_levels, case.frames)
    limits, sweeps = {}, {}
    with status("limits") as show:
        for name, sensor in sensors.items():

            def told(text: str, name: str = name) -> None:
                show(f"{name}: {text}")

            with located(f"sensor {name}"):
                limits[name] = dome_limit(sensor, case.grip(), noises, told)
                if swept:
                    sweeps[name] = sweep_dome(sensor, case.grip(), noises, progress=told)
    return limits, sweeps


def _report(
    case: DomeCase, limits: dict[str, "DomeLimit"], sweeps: dict[str, "list[DomePoint]"]
) -> dict[str, Any]:
    """Entries of `--json` and of limit.json."""
    from ..measure.limits.dome.sweep import DOME_DIALS, needed_of

    entries = {name: found.entry() for name, found in limits.items()}
    wanted = case.margin_error
    if wanted is not None:
        for name, points in sweeps.items():
            entries[name]["needed"] = {
                dial: needed_of([p for p in points if p.dial == dial], wanted)
                for dial in DOME_DIALS
            }
    radius = None if math.isinf(case.radius_mm) else case.radius_mm
    return {"body": "dome", **asdict(case), "radius_mm": radius, "sensors": entries}


def _print_limits(limits: dict[str, "DomeLimit"]) -> None:
    """Smallest deviations, a row for each way to read a design and each model of noise."""
    print(f"{'smallest standard deviation of':<44}" + "".join(f"{h:>10}" for _, h, _ in COLUMNS))
    for name, found in limits.items():
        layers = {1: "one layer moves", 2: "both layers move"}.get(found.moving, "no layer moves")
        read = ", ".join(found.read_by) or "no reconstructor"
        print(f"{name}: {layers}, true Γ {found.held.margin:.3f}; read by {read}")
        for what, each in found.rows().items():
            for noise, told in each.items():
                row = "".join(
                    f"{_short(factor * getattr(told, key)):>10}" for key, _, factor in COLUMNS
                )
                print(f"  {f'{what}, {noise}':<42}{row}")


def _short(value: float) -> str:
    """Three digits; `–` for what is not told."""
    if math.isnan(value):
        return "–"
    return f"{value:.0f}" if value >= 1000.0 else f"{value:.3g}"


def _print_needs(entries: dict[str, Any], wanted: float) -> None:
    """Value of each dial that the wanted error of Γ needs, a column for each design."""
    from ..measure.limits.dome.sweep import DOME_DIALS

    width = max(14, 2 + max(map(len, entries)))
    print(
        f"for an error of Γ of {wanted:g} by a contact, misfit included, all else as designed "
        "(nearest to the design):"
    )
    print(" " * 42 + "".join(f"{name:>{width}}" for name in entries))
    for key, dial in DOME_DIALS.items():
        needs = [entry["needed"][key] for entry in entries.values()]
        row = "".join(f"{'unreachable' if n is None else f'{n:.3g}':>{width}}" for n in needs)
        unit = f" [{dial.unit}]" if dial.unit else ""
        print(f"{dial.label + unit:<42}{row}")
