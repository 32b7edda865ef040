"""The command `chromagrip limit`."""

import json
import math
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from ..errors import UserError
from ..scene.scene import load_scene
from .options import Force, JsonOnly, option, telling

_LABELS = {
    "any_normal": "ΣFn of any smooth forces [N]",
    "any_friction": "ΣFf of any smooth forces [N]",
    "normal": "ΣFn of an object's contact [N]",
    "friction": "ΣFf of an object's contact [N]",
    "mu": "µ",
    "margin": "Γ",
}


def limit(
    *,
    sensor: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option("design to look at, thesis by default; may be repeated", "NAME|FILE.toml"),
    ] = (),
    grip: Annotated[float, option("grip force", "N")] = 1.86,
    load: Annotated[float, option("lateral load, raised after the grip", "N")] = 0.65,
    friction: Annotated[float, option("of the object", "MU")] = 0.5,
    radius_mm: Annotated[float, option("of the object; inf is flat", "MM")] = math.inf,
    stiffness_kpa: Annotated[float, option("Young's modulus of the object", "KPA")] = 200.0,
    noise: Annotated[float, option("standard deviation of each sRGB level", "LEVELS")] = 2.0,
    frames: Annotated[int, option("averaged; 16 at rest", "N")] = 1,
    margin_error: Annotated[
        float | None, option("say what of a design is needed for this error of Γ", "GAMMA")
    ] = None,
    out: Annotated[
        Path | None, option("folder for the chart and its table; nothing without", "DIR")
    ] = None,
    force: Force = False,
    json_only: JsonOnly = False,
) -> int:
    """Smallest errors of ΣFn, ΣFf, µ and Γ that an image of a sensor allows, at one pose.

    What the best estimate from one image is wrong by on average if it knows neither the object nor
    its history; `docs/what-the-image-tells.md` says what is taken as known.
    """
    for name, value in (("--noise", noise), ("--margin-error", margin_error)):
        if value is not None and not 0.0 < value < math.inf:
            raise UserError(f"{name} must be finite and above 0, got {value:g}")
    if frames < 1:
        raise UserError(f"--frames must be 1 or more, got {frames}")
    names = tuple(dict.fromkeys(sensor)) or ("thesis",)
    scenes = {
        name: load_scene(
            changes={
                "sensor": name,
                "object.friction": friction,
                "object.radius_mm": radius_mm,
                "object.stiffness_kpa": stiffness_kpa,
            }
        )
        for name in names
    }
    from ..measure.limits.forces import force_limit, press  # Numba and matplotlib load only here
    from ..measure.limits.sweep import DIALS, draw, needed, sweep, write_table
    from ..output.folder import prepare

    sensors = {name: scene.build_sensor() for name, scene in scenes.items()}
    for name, design in sensors.items():
        if design.shape.flat:
            raise UserError(f"sensor {name} is a flat pad, which the node model does not describe")
    if out is not None:
        prepare(out, force)
    found: dict[str, dict[str, Any]] = {}
    sweeps = {}
    with Console(stderr=True).status("") as status:
        tell = telling(status)
        for name, scene in scenes.items():
            tell(f"{name}: contact")
            pressed = press(scene.build_fingertip(), scene.build_object(), grip, load)
            limits = force_limit(sensors[name], pressed, noise, frames=frames)
            field = pressed.field
            found[name] = {
                "normal_n": field.total_normal,
                "friction_n": field.total_friction,
                "margin": field.safety_margin(friction),
                "limits": vars(limits),
            }
            if out is None and margin_error is None:
                continue
            points = sweeps[name] = sweep(
                sensors[name], pressed, noise, frames=frames, progress=tell
            )
            if margin_error is not None:
                found[name]["needed"] = {
                    dial: needed([p for p in points if p.dial == dial], margin_error)
                    for dial in DIALS
                }
    report: dict[str, Any] = {
        "grip_n": grip,
        "load_n": load,
        "friction": friction,
        "radius_mm": None if math.isinf(radius_mm) else radius_mm,
        "stiffness_kpa": stiffness_kpa,
        "noise_levels": noise,
        "frames": frames,
        "margin_error": margin_error,
        "sensors": found,
    }
    form = "flat" if math.isinf(radius_mm) else f"of radius {radius_mm:g} mm"
    title = (
        f"Grip {grip:g} N, load {load:g} N, µ {friction:g}, object {form}, {stiffness_kpa:g} kPa; "
        f"noise {noise:g} levels, frames averaged: {frames}"
    )
    if out is not None:
        draw(sensors, sweeps, noise, title, out / "limit.png")
        write_table(sweeps, out / "limit.csv")
        (out / "limit.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    if json_only:
        print(json.dumps(report))
        return 0
    print(title)
    _print_limits(found)
    if margin_error is not None:
        _print_needs(found, margin_error)
    if out is not None:
        print(f"folder {out}, see {out / 'limit.png'}")
    return 0


def _print_limits(found: dict[str, dict[str, Any]]) -> None:
    """Truth and smallest deviations, a column for each sensor."""
    print(f"{'smallest standard deviation of':<34}" + "".join(f"{n:>12}" for n in found))
    for key, label in _LABELS.items():
        row = "".join(f"{entry['limits'][key]:>12.4f}" for entry in found.values())
        print(f"{label:<34}{row}")
    row = "".join(f"{entry['margin']:>12.3f}" for entry in found.values())
    print(f"{'true Γ':<34}{row}")


def _print_needs(found: dict[str, dict[str, Any]], wanted: float) -> None:
    """What of each design a wanted error of Γ takes."""
    from ..measure.limits.sweep import DIALS, STEPS

    print(
        f"for an error of Γ of {wanted:g}, all else as in the design "
        f"({STEPS[0]:g} to {STEPS[-1]:g} times its own tried):"
    )
    for key, dial in DIALS.items():
        row = "".join(
            f"{'not to be had' if need is None else f'{need:.3g}':>14}"
            for need in (entry["needed"][key] for entry in found.values())
        )
        word = "at most" if key == "noise" else "at least"
        print(f"{f'{dial.label}, {word} {dial.unit}':<32}{row}")
