"""The command `chromagrip render`."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..errors import UserError
from ..scene.scene import DEFAULT_SCENE, Scene, load_scene, parse_change
from .options import Changes, JsonOnly, Out, Overwrite, counting, new_folder, option

if TYPE_CHECKING:
    from ..loop.poses import Pose


def render(
    *,
    scene: Annotated[
        str, option("scene whose object and sensor are used, or a .toml file", "NAME|FILE.toml")
    ] = DEFAULT_SCENE,
    sensor: Annotated[
        str | None, option("sensor design, see `chromagrip sensors`, or a .toml file", "NAME|FILE")
    ] = None,
    grip: Annotated[tuple[float, ...], option("grip forces of the sweep", "N...")] = (),
    load: Annotated[tuple[float, ...], option("lateral loads, at each grip", "N...")] = (),
    press_mm: Annotated[tuple[float, ...], option("depths, of a flat pad", "MM...")] = (),
    shear_mm: Annotated[tuple[float, ...], option("shears of a pad, at each depth", "MM...")] = (),
    renderer: Annotated[str | None, option("instead of the scene's", "NAME")] = None,
    noise: Annotated[
        float | None, option("standard deviation, short for camera.noise_levels", "LEVELS")
    ] = None,
    seed: Annotated[int | None, option("of noise and defects", "N")] = None,
    changes: Changes = (),
    out: Out = None,
    overwrite: Overwrite = False,
    json_only: JsonOnly = False,
) -> int:
    """Take pictures of poses, with everything that is true of them.

    One pose by default (2 N of grip, 0.3 N of load); lists of forces make a sweep. Each picture
    comes with marker centres, visibility, overlaps, masks, flow, depth and forces, and a preview.

    Example: chromagrip render --grip 1 2 4 --load 0 0.4
    """
    shortcuts = {
        "sensor": sensor,
        "renderer": renderer,
        "camera.noise_levels": noise,
        "seed": seed,
    }
    changed: dict[str, Any] = {k: v for k, v in shortcuts.items() if v is not None}
    changed |= dict(parse_change(text) for text in changes)
    resolved = load_scene(scene, changed)
    poses = _poses(resolved, grip, load, press_mm, shear_mm)
    if out is None and not json_only:
        out = new_folder(f"render-{Path(resolved.sensor).stem}")

    from ..loop.pose_folder import render_poses  # OpenCV loads only when something is drawn

    with counting("rendering", "poses") as progress:
        report = render_poses(resolved, poses, out, overwrite, progress)
    if json_only:
        print(json.dumps(report))
        return 0
    for entry in report["poses"]:
        numbers = ", ".join(
            f"{key} {value:.3g}" for key, value in entry.items() if isinstance(value, float | int)
        )
        print(f"{entry['image']}  {numbers}")
    print(f"folder {out}, see {report['poses'][0]['preview']}")
    return 0


def _poses(
    scene: Scene,
    grip: tuple[float, ...],
    load: tuple[float, ...],
    press_mm: tuple[float, ...],
    shear_mm: tuple[float, ...],
) -> "list[Pose]":
    """Poses of the sweep: forces on a dome, or depths and shears; one by default."""
    from ..loop.poses import Pose

    numbers = (*grip, *load, *press_mm, *shear_mm)
    if not all(map(math.isfinite, numbers)) or min((*grip, *press_mm), default=0.0) < 0.0:
        raise UserError("--grip and --press-mm must be 0 or more, and all numbers finite")
    flat = scene.build_sensor().shape.flat
    if press_mm or shear_mm or (flat and not (grip or load)):
        presses = press_mm or ((1.0,) if flat and not (grip or load) else (0.0,))
        shears = shear_mm or ((0.0,) if press_mm else (0.5,))
        return [Pose(depth=d * 1e-3, shear=s * 1e-3) for d in presses for s in shears]
    grips = grip or (2.0,)
    loads = load or ((0.0,) if grip else (0.3,))
    return [Pose(grip=g, load=f) for g in grips for f in loads]
