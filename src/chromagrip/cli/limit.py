"""The command `limit`: the smallest errors that a picture of a sensor allows."""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ..errors import UserError
from ..scene import Scene, load_scene
from ..scene.scene import Body
from .limit_dome import DOME_LOAD, DomeCase, print_dome_limits
from .options import JsonOnly, Overwrite, option, status

if TYPE_CHECKING:
    from ..measure.limits.forces import ForceLimit
    from ..measure.limits.sweep import Point

#: Label of each error in the printed table.
LABELS = {
    "any_normal": "ΣFn of any smooth forces [N]",
    "any_friction": "ΣFf of any smooth forces [N]",
    "normal": "ΣFn of an object's contact [N]",
    "friction": "ΣFf of an object's contact [N]",
    "mu": "µ",
    "margin": "Γ",
}


@dataclass(frozen=True, kw_only=True)
class Case:
    """Contact and camera whose limits are computed; units as in the command's options."""

    grip_n: float
    load_n: float
    friction: float
    radius_mm: float
    stiffness_kpa: float
    noise_levels: float
    frames: int
    margin_error: float | None

    @property
    def title(self) -> str:
        """The case in one line."""
        form = "flat" if math.isinf(self.radius_mm) else f"of radius {self.radius_mm:g} mm"
        return (
            f"Grip {self.grip_n:g} N, load {self.load_n:g} N, µ {self.friction:g}, object {form}, "
            f"{self.stiffness_kpa:g} kPa; noise {self.noise_levels:g} levels, "
            f"frames averaged: {self.frames}"
        )

    def scene(self, sensor: str) -> Scene:
        """Scene with the object and a sensor."""
        changes = {
            "sensor": sensor,
            "object.friction": self.friction,
            "object.radius_mm": self.radius_mm,
            "object.stiffness_kpa": self.stiffness_kpa,
        }
        return load_scene(changes=changes)


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of one sensor.

    Attributes
    ----------
    normal_n, friction_n, margin: truth of the contact
    limits: smallest standard deviations
    needed: value of each dial that the wanted error of Γ needs; None where no value is enough
    """

    normal_n: float
    friction_n: float
    margin: float
    limits: "ForceLimit"
    needed: dict[str, float | None] | None


def limit(
    *,
    sensor: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option("design, thesis or every dome by default; may be repeated", "NAME|FILE.toml"),
    ] = (),
    body: Annotated[
        Body, option("node chain, or silicone in three dimensions", "chain|dome")
    ] = "chain",
    grip: Annotated[float | None, option("grip force; 1.86, of a dome 3", "N")] = None,
    load: Annotated[
        float | None,
        option("lateral load, raised after the grip; 0.65, on a dome for Γ = 0.3", "N"),
    ] = None,
    azimuth_deg: Annotated[
        float | None, option("direction of the load from the picture's x, on a dome", "DEG")
    ] = None,
    shears: Annotated[
        int | None, option("pictures of the shear that are read together, of a dome; 3", "N")
    ] = None,
    friction: Annotated[float, option("of the object", "MU")] = 0.5,
    radius_mm: Annotated[float, option("of the object; inf is flat", "MM")] = math.inf,
    stiffness_kpa: Annotated[float, option("Young's modulus of the object", "KPA")] = 200.0,
    noise: Annotated[float, option("standard deviation of each sRGB level", "LEVELS")] = 2.0,
    frames: Annotated[int, option("averaged; 16 at rest", "N")] = 1,
    margin_error: Annotated[
        float | None, option("report what a design needs for this error of Γ", "GAMMA")
    ] = None,
    out: Annotated[
        Path | None, option("folder for the chart and its table; nothing without", "DIR")
    ] = None,
    overwrite: Overwrite = False,
    json_only: JsonOnly = False,
) -> int:
    """Smallest errors of ΣFn, ΣFf, µ and Γ that a picture of a sensor allows, at one pose.

    They are the errors of the best estimate from one picture that knows neither the object nor its
    history; `docs/what-the-image-tells.md` lists what is taken as known. Of a dome of silicone they
    are those of a contact that is fitted to some pictures, and of free tractions.

    Example: chromagrip limit --sensor thesis --sensor fovea --margin-error 0.03
    """
    for name, value in (("--noise", noise), ("--margin-error", margin_error)):
        if value is not None and not 0.0 < value < math.inf:
            raise UserError(f"{name} must be finite and above 0, got {value:g}")
    if frames < 1:
        raise UserError(f"--frames must be 1 or more, got {frames}")
    if body == "dome":
        pressed = 3.0 if grip is None else grip
        dome = DomeCase(
            grip_n=pressed,
            load_n=DOME_LOAD * friction * pressed if load is None else load,
            azimuth_deg=azimuth_deg or 0.0,
            friction=friction,
            radius_mm=radius_mm,
            stiffness_kpa=stiffness_kpa,
            shears=3 if shears is None else shears,
            noise_levels=noise,
            frames=frames,
            margin_error=margin_error,
        )
        print_dome_limits(dome, sensor, out, overwrite, json_only)
        return 0
    for option_name, given in (("--azimuth-deg", azimuth_deg), ("--shears", shears)):
        if given is not None:
            raise UserError(f"{option_name} is of a dome: add --body dome")
    case = Case(
        grip_n=1.86 if grip is None else grip,
        load_n=0.65 if load is None else load,
        friction=friction,
        radius_mm=radius_mm,
        stiffness_kpa=stiffness_kpa,
        noise_levels=noise,
        frames=frames,
        margin_error=margin_error,
    )
    scenes = {name: case.scene(name) for name in dict.fromkeys(sensor or ("thesis",))}
    for name, scene in scenes.items():
        if scene.build_sensor().shape.flat:
            raise UserError(f"sensor {name} is a flat pad, which the node model does not describe")

    from ..output.folder import prepare

    if out is not None:
        prepare(out, overwrite)
    limits, sweeps = _compute(case, scenes, swept=out is not None or margin_error is not None)
    report = _report(case, limits)
    if out is not None:
        _write(case, scenes, sweeps, report, out)
    if json_only:
        print(json.dumps(report))
        return 0
    print(case.title)
    _print_limits(limits)
    if margin_error is not None:
        _print_needs(limits, margin_error)
    if out is not None:
        print(f"folder {out}, see {out / 'limit.png'}")
    return 0


def _compute(
    case: Case, scenes: dict[str, Scene], swept: bool
) -> tuple[dict[str, Limits], dict[str, "list[Point]"]]:
    """Limits of each sensor, and with `swept` those of designs that differ from it."""
    from ..measure.limits.forces import force_limit, press  # Numba and matplotlib load only here
    from ..measure.limits.sweep import DIALS, needed, sweep

    limits, sweeps = {}, {}
    with status("contact") as show:
        for name, scene in scenes.items():
            show(f"{name}: contact")
            design = scene.build_sensor()
            pressed = press(scene.build_fingertip(), scene.build_object(), case.grip_n, case.load_n)
            if swept:
                sweeps[name] = sweep(
                    design, pressed, case.noise_levels, frames=case.frames, progress=show
                )
            wanted = case.margin_error
            limits[name] = Limits(
                normal_n=pressed.field.total_normal,
                friction_n=pressed.field.total_friction,
                margin=pressed.field.safety_margin(case.friction),
                limits=force_limit(design, pressed, case.noise_levels, frames=case.frames),
                needed=None
                if wanted is None
                else {
                    dial: needed([p for p in sweeps[name] if p.dial == dial], wanted)
                    for dial in DIALS
                },
            )
    return limits, sweeps


def _report(case: Case, limits: dict[str, Limits]) -> dict[str, object]:
    """Entries of `--json` and of limit.json."""
    entries = {name: asdict(entry) for name, entry in limits.items()}
    for entry in entries.values():
        if entry["needed"] is None:
            del entry["needed"]
    radius = None if math.isinf(case.radius_mm) else case.radius_mm
    return {**asdict(case), "radius_mm": radius, "sensors": entries}


def _write(
    case: Case,
    scenes: dict[str, Scene],
    sweeps: dict[str, "list[Point]"],
    report: dict[str, object],
    out: Path,
) -> None:
    from ..measure.limits.sweep import draw, write_table

    sensors = {name: scene.build_sensor() for name, scene in scenes.items()}
    draw(sensors, sweeps, case.noise_levels, case.title, out / "limit.png")
    write_table(sweeps, out / "limit.csv")
    (out / "limit.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


def _print_limits(limits: dict[str, Limits]) -> None:
    """Truth and smallest deviations, a column for each sensor."""
    print(f"{'smallest standard deviation of':<34}" + "".join(f"{n:>12}" for n in limits))
    for key, label in LABELS.items():
        row = "".join(f"{getattr(entry.limits, key):>12.4f}" for entry in limits.values())
        print(f"{label:<34}{row}")
    row = "".join(f"{entry.margin:>12.3f}" for entry in limits.values())
    print(f"{'true Γ':<34}{row}")


def _print_needs(limits: dict[str, Limits], wanted: float) -> None:
    """Value of each dial that the wanted error of Γ needs, a column for each sensor."""
    from ..measure.limits.sweep import DIALS, STEPS

    print(
        f"for an error of Γ of {wanted:g}, all else as in the design "
        f"({STEPS[0]:g} to {STEPS[-1]:g} times its own tried):"
    )
    for key, dial in DIALS.items():
        needs = [entry.needed[key] for entry in limits.values() if entry.needed is not None]
        row = "".join(f"{'unreachable' if n is None else f'{n:.3g}':>14}" for n in needs)
        word = "at most" if key == "noise" else "at least"
        print(f"{f'{dial.label}, {word} {dial.unit}':<32}{row}")
