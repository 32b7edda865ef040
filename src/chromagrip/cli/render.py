"""The command `chromagrip render`."""

import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..errors import UserError, meant
from ..scene.scene import Body, Scene, load_scene
from .options import (
    Allow,
    Changes,
    JsonOnly,
    Out,
    Overwrite,
    changes_of,
    counting,
    new_folder,
    option,
)
from .readouts import make_dome_tables

#: Shapes of `--object` with their usual lengths; `--set object.size_mm=…` gives others.
OBJECTS: dict[str, dict[str, Any]] = {
    "cylinder": {"object.size_mm": (4.0, 30.0), "object.rounding_mm": 0.5},
    "box": {"object.size_mm": (10.0, 10.0, 10.0), "object.rounding_mm": 0.5},
    "capsule": {"object.size_mm": (2.0, 10.0)},
    "torus": {"object.size_mm": (4.0, 1.0)},
    "cone": {"object.size_mm": (6.0, 6.0), "object.rounding_mm": 0.5},
}

#: Share of the silicone's thickness up to which its markers were compared with finite elements.
DEEPEST = 0.5
#: Largest tilt of an object about an axis, as in recipes [°].
STEEPEST_DEG = 90.0
#: Radius of the ball [mm].
BALL_MM = 8.0


def _sizes_said() -> str:
    """Shapes with their usual lengths [mm], as the keys of a scene have them."""
    sized = [
        f"{name} ({' × '.join(f'{length:g}' for length in keys['object.size_mm'])} mm)"
        for name, keys in OBJECTS.items()
    ]
    return ", ".join(("plane", f"ball (radius {BALL_MM:g} mm)", *sized))


if TYPE_CHECKING:
    from ..loop.poses.dome_poses import DomePose
    from ..loop.poses.poses import AnyPose, Entry, Pose


@dataclass(frozen=True, kw_only=True)
class Asked:
    """Options that place the object, as given."""

    grip: tuple[float, ...]
    load: tuple[float, ...]
    press_mm: tuple[float, ...]
    shear_mm: tuple[float, ...]
    twist_deg: float | None
    tilt_deg: tuple[float, ...]
    azimuth_deg: float | None
    force: tuple[float, ...]
    moment: float | None


def render(
    *,
    scene: Annotated[
        str, option("scene with object and sensor, shipped or a .toml file", "NAME|FILE.toml")
    ] = "camera-100hz",
    sensor: Annotated[
        str | None,
        option("sensor design, see `chromagrip list sensors`, or a .toml file", "NAME|FILE"),
    ] = None,
    grip: Annotated[tuple[float, ...], option("grip forces in N", "N...")] = (),
    load: Annotated[
        tuple[float, ...], option("lateral loads in N, each at every grip", "N...")
    ] = (),
    press_mm: Annotated[
        tuple[float, ...], option("depths in mm, of a flat pad or a dome of silicone", "MM...")
    ] = (),
    shear_mm: Annotated[
        tuple[float, ...],
        option(
            "shears in mm: of a pad each at every depth, of a dome of silicone along x and y",
            "MM...",
        ),
    ] = (),
    object: Annotated[
        str | None,
        option(
            f"object on a dome of silicone: a file of triangles, or {_sizes_said()}; --set "
            "object.KEY=VALUE gives other sizes",
            "SHAPE|FILE",
        ),
    ] = None,
    twist_deg: Annotated[
        float | None, option("turn about the dome's axis in °, after the press", "DEG")
    ] = None,
    tilt_deg: Annotated[
        tuple[float, ...], option("tilt of the object about x and y in °, before the press", "X Y")
    ] = (),
    azimuth_deg: Annotated[
        float | None, option("turn about the dome's axis in °, before the press", "DEG")
    ] = None,
    force: Annotated[
        tuple[float, ...],
        option("force along x, along y and down in N, instead of press and shear", "N N N"),
    ] = (),
    moment: Annotated[
        float | None, option("moment about the dome's axis in N·mm, instead of the twist", "N·MM")
    ] = None,
    renderer: Annotated[
        str | None,
        option("renderer, instead of the scene's; see `chromagrip list renderers`", "NAME"),
    ] = None,
    noise: Annotated[
        float | None,
        option(
            "standard deviation of the camera noise in levels of 0 to 255, short for "
            "camera.noise_levels",
            "LEVELS",
        ),
    ] = None,
    seed: Annotated[int | None, option("seed of noise and defects", "N")] = None,
    changes: Changes = (),
    allow: Allow = (),
    out: Out = None,
    overwrite: Overwrite = False,
    json_only: JsonOnly = False,
) -> int:
    """Draw pictures of poses, with their true values.

    The default is one pose (grip 2 N, load 0.3 N); lists of forces make a sweep. Each picture has
    marker centres, visibility, overlaps, masks, flow, depth and forces, and a preview.
    `chromagrip track` and `estimate` read the folder, with its rest.png.
    With --object, or a scene with body = "dome", the fingertip is a dome or a flat pad of silicone
    in 3D. The object is tilted and turned, pressed to each depth, then sheared and twisted.

    Example: chromagrip render --grip 1 2 4 --load 0 0.4
    """
    shortcuts = {
        "sensor": sensor,
        "renderer": renderer,
        "camera.noise_levels": noise,
        "seed": seed,
    }
    changed: dict[str, Any] = {k: v for k, v in shortcuts.items() if v is not None}
    typed = changes_of(changes, changed)
    changed |= _object(object) | typed
    usual = {"dome": {"path": "truth"}}  # a picture needs no estimator
    changed = usual.get(str(changed.get("body")), {}) | changed
    resolved = load_scene(scene, changed, allow=allow)
    asked = Asked(
        grip=grip, load=load, press_mm=press_mm, shear_mm=shear_mm, twist_deg=twist_deg,
        tilt_deg=tilt_deg, azimuth_deg=azimuth_deg, force=force, moment=moment,
    )  # fmt: skip
    poses_of: dict[Body, Callable[[Scene, Asked], Sequence[AnyPose]]]
    poses_of = {"chain": _chain_poses, "dome": _dome_poses}
    poses = poses_of[resolved.body](resolved, asked)
    if out is None and not json_only:
        out = new_folder(f"render-{Path(resolved.sensor).stem}")

    from ..loop.poses.folder import render_poses  # OpenCV loads only when something is drawn

    make_dome_tables(resolved, pictures=True)
    again = _again(asked)
    with counting("rendering", "poses") as progress:
        report = render_poses(resolved, poses, out, overwrite, progress, again)
    _warn_of_depth(resolved, report["poses"])
    if json_only:
        print(json.dumps(report))
        return 0
    for entry in report["poses"]:
        numbers = ", ".join(
            f"{key} {round(value, 4):z.3g}"
            for key, value in entry.items()
            if isinstance(value, float | int)
        )
        print(f"{entry['image']}  {numbers}")
    print(f"folder {out}, see {report['poses'][0]['preview']}")
    return 0


def _plain(value: float) -> str:
    """Number of three digits, without what is the solver's."""
    least = 5e-5  # values below this are rounding errors of a contact [N, N·mm, mm]
    return f"{0.0 if abs(value) < least else value:.3g}"


def _again(asked: Asked) -> str:
    """Command that takes the same poses of the scene that is written."""
    words = ["chromagrip", "render", "--scene", "scene.toml"]
    for name, value in vars(asked).items():
        values = value if isinstance(value, tuple) else () if value is None else (value,)
        if values:
            words += [f"--{name.replace('_', '-')}", *(repr(number) for number in values)]
    return " ".join(words)


def _warn_of_depth(scene: Scene, entries: "list[Entry]") -> None:
    """Say of poses that are deeper than the silicone's motion was compared with anything."""
    deepest = max(float(entry.get("deepest_mm", 0.0)) for entry in entries)  # type: ignore[arg-type]
    share = 1e-3 * deepest / scene.build_dome().thickness if deepest > 0.0 else 0.0
    if share > DEEPEST:
        print(
            f"chromagrip: the skin is pressed by {share:.0%} of the silicone's thickness; "
            f"markers and forces were compared with finite elements up to {DEEPEST:.0%} only, see "
            "docs/dome.md",
            file=sys.stderr,
        )


def _chain_poses(scene: Scene, asked: Asked) -> "list[Pose]":
    """Poses of the sweep: forces on a dome, or depths and shears; one by default."""
    from ..loop.poses.poses import Pose

    for name in ("twist_deg", "tilt_deg", "azimuth_deg", "force", "moment"):
        if getattr(asked, name) not in (None, ()):
            flag = name.replace("_", "-")
            raise UserError(f"--{flag} is for a dome of silicone: give --object too")
    grip, load, press_mm, shear_mm = asked.grip, asked.load, asked.press_mm, asked.shear_mm
    _check_numbers(grip=grip, load=load, press_mm=press_mm, shear_mm=shear_mm)
    flat = scene.build_sensor().shape.flat
    if press_mm or shear_mm or (flat and not (grip or load)):
        presses = press_mm or ((1.0,) if flat and not (grip or load) else (0.0,))
        shears = shear_mm or ((0.0,) if press_mm else (0.5,))
        return [Pose(depth=d * 1e-3, shear=s * 1e-3) for d in presses for s in shears]
    grips = grip or (2.0,)
    loads = load or ((0.0,) if grip else (0.3,))
    return [Pose(grip=g, load=f) for g in grips for f in loads]


def _check_numbers(**options: tuple[float, ...]) -> None:
    """Refuse numbers of options that are not finite, and grips, depths and forces down below 0."""
    for name, values in options.items():
        low = {"grip": values, "press_mm": values, "force": values[2:]}.get(name, ())
        wrong = [v for v in values if not math.isfinite(v)] + [v for v in low if v < 0.0]
        if wrong:
            unit = {"grip": " N", "load": " N", "force": " N", "moment": " N·mm"}.get(name, "")
            least = "0 or more" if wrong[0] in low else "a finite number"
            down = " downwards" if name == "force" and wrong[0] in low else ""
            flag = name.replace("_", "-")
            raise UserError(f"--{flag} {wrong[0]:g}{unit}{down}: expected {least}")


def _object(name: str | None) -> dict[str, Any]:
    """Changes of a scene for an object on a dome of silicone: a shape, or a file of triangles."""
    if name is None:
        return {}
    changes: dict[str, Any] = {"body": "dome", "path": "truth"}
    if name == "plane":
        return changes | {"object.radius_mm": math.inf}
    if name == "ball":
        return changes | {"object.radius_mm": BALL_MM}
    if name in OBJECTS:
        return changes | {"object.radius_mm": math.inf, "object.shape": name, **OBJECTS[name]}
    if not Path(name).suffix:
        raise UserError(
            f"--object {name}{meant(name, ('plane', 'ball', *OBJECTS))} is neither a file nor one "
            f"of plane, ball, {', '.join(OBJECTS)}"
        )
    return changes | {"object.radius_mm": math.inf, "object.mesh": name}


def _dome_poses(scene: Scene, asked: Asked) -> "list[DomePose]":
    """Poses of an object on a dome, one for each depth."""
    from ..loop.poses.dome_poses import DomePose

    if asked.grip or asked.load:
        raise UserError("--grip and --load are for the chain; a dome takes --press-mm or --force")
    press_mm, shear_mm, tilt_deg, force = (
        asked.press_mm, asked.shear_mm, asked.tilt_deg, asked.force,
    )  # fmt: skip
    twist_deg, azimuth_deg, moment = asked.twist_deg, asked.azimuth_deg or 0.0, asked.moment
    for name, values, counts in (
        ("--shear-mm", shear_mm, (0, 1, 2)), ("--tilt-deg", tilt_deg, (0, 2)),
        ("--force", force, (0, 3)),
    ):  # fmt: skip
        if len(values) not in counts:
            allowed = " or ".join(str(count) for count in counts if count)
            raise UserError(f"{name} of a dome takes {allowed} numbers, got {len(values)}")
    if force and (press_mm or shear_mm):
        raise UserError("--force replaces --press-mm and --shear-mm: give one or the other")
    if moment is not None and twist_deg is not None:
        raise UserError("--moment replaces --twist-deg: give one or the other")
    _check_numbers(
        press_mm=press_mm, shear_mm=shear_mm, tilt_deg=tilt_deg, force=force,
        azimuth_deg=(azimuth_deg,), twist_deg=(twist_deg or 0.0,), moment=(moment or 0.0,),
    )  # fmt: skip
    steep = next((tilt for tilt in tilt_deg if not abs(tilt) <= STEEPEST_DEG), None)
    if steep is not None:
        raise UserError(
            f"--tilt-deg {steep:g}: expected -{STEEPEST_DEG:g} to {STEEPEST_DEG:g} about each axis"
        )
    shear_x, shear_y = (*(1e-3 * shear for shear in shear_mm), 0.0, 0.0)[:2]
    tilt = (math.radians(tilt_deg[0]), math.radians(tilt_deg[1])) if tilt_deg else (0.0, 0.0)
    return [
        DomePose(
            press=1e-3 * press,
            shear=(shear_x, shear_y),
            twist=math.radians(twist_deg or 0.0),
            tilt=tilt,
            azimuth=math.radians(azimuth_deg),
            force=(force[0], force[1], force[2]) if force else None,
            moment=None if moment is None else 1e-3 * moment,
        )
        for press in (press_mm or ((0.0,) if force else (0.6,)))
    ]
