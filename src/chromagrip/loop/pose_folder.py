"""`chromagrip render`: pictures of poses with their ground truth, in a folder of files."""

import json
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import TypedDict

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..model import ForceField, State, rest_state, whole_friction
from ..output.folder import prepare
from ..output.processes import one_thread
from ..output.versions import versions
from ..render import TruthMap, camera_text
from ..scene.scene import Scene
from .grasp import open_camera
from .pose_preview import draw_preview
from .poses import Pose, Shot, settle
from .run_folder import scene_text

FORMAT = "chromagrip render 1"

#: One picture of `poses.json`: names of its files, and forces or displacements.
Entry = dict[str, str | float | None]


class Report(TypedDict):
    """Contents of `poses.json`."""

    format: str
    sensor: str
    renderer: str
    files: dict[str, str]
    arrays: dict[str, str]
    poses: list[Entry]
    versions: dict[str, str]


#: Arrays of a truth file, in order, with their meaning; layer 0 is magenta, 1 yellow.
ARRAYS = {
    "pixels_px": "projected centre (x, y) of each marker, (2, M, 2)",
    "image_centres_px": "centroid (x, y) of each marker's outline in the image, (2, M, 2)",
    "areas_px2": "area of each outline, (2, M)",
    "visible": "marker is there, faces the camera and lies in the image, (2, M)",
    "overlap": "share of each magenta marker's image that yellow covers, (M,)",
    "centres_m": "marker centres (x, y, z) in the sensor frame, (2, M, 3)",
    "normals": "of the markers, outwards, (2, M, 3)",
    "masks": "share of each pixel that a layer covers, 255 is all, (2, H, W)",
    "flow_px": "motion (x, y) of what a resting pixel shows of a layer, NaN off it, (2, H, W, 2)",
    "depth_m": "distance from the camera to the skin along each pixel's ray, NaN off it, (H, W)",
    "seen_m": "node displacements (x, z) relative to the camera, (N, 2)",
    "force_position_m": "place (x, z) of each node's contact force, (N, 2); forces of a dome only",
    "force_normal_n": "normal force on each node, (N,)",
    "force_friction_n": "friction on each node, along the object's tangent, (N,)",
    "force_contact": "node is in contact, (N,)",
}


def render_poses(
    scene: Scene,
    poses: list[Pose],
    out: Path | None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Report:
    """Take a picture of each pose; with a folder, write them with their truth and previews.

    Parameters
    ----------
    scene: object, fingertip, sensor, renderer, defects, noise and seed
    poses: of the fingertip
    out: folder, made if missing
    overwrite: write into a folder that is not empty, over an earlier result
    progress: called after every picture

    Returns
    -------
    Contents of `poses.json`.

    Raises
    ------
    UserError
        For a pose, a folder or a renderer that cannot be used.
    """
    # Every pose is settled first, so that one that cannot be held leaves no half-written folder.
    settled = []
    for pose in poses:
        settled.append((pose, *settle(scene, pose)))
        progress(0, len(poses))
    if out is not None:
        prepare(out, overwrite)
        (out / "poses.json").unlink(missing_ok=True)
    entries = []
    try:
        for number, shot in enumerate(_shots(scene, settled, out)):
            entries.append(_entry(shot, number))
            if out is not None:
                _write(out, number, shot)
                draw_preview(scene, shot, out / f"preview-{number:03d}.png")
            progress(number + 1, len(poses))
        report: Report = {
            "format": FORMAT,
            "sensor": scene.sensor,
            "renderer": scene.renderer,
            "files": {
                "scene.toml": "everything this was made from",
                "camera.yml": "the camera, in OpenCV's format",
                "rest.png": "the unloaded sensor, same specimen and noise",
            },
            "arrays": ARRAYS,
            "poses": entries,
            "versions": versions(),
        }
        if out is not None:
            (out / "scene.toml").write_text(scene_text(scene), encoding="utf-8")
            camera = camera_text(scene.build_sensor().view.camera)
            (out / "camera.yml").write_text(camera, encoding="utf-8")
            # Last, so that a folder that has it is complete.
            (out / "poses.json").write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise UserError(f"folder {out} cannot be written: {error.strerror}") from None
    return report


def _shots(
    scene: Scene, settled: list[tuple[Pose, State, ForceField | None]], out: Path | None
) -> Iterator[Shot]:
    """Pictures of settled poses, in order; the rest frame is written on the way."""
    sensor, nodes = scene.build_sensor(), scene.fingertip.nodes
    truth, tip, obj = TruthMap(sensor, nodes), scene.build_fingertip(), scene.build_object()
    with closing(open_camera(scene)) as camera, one_thread():
        if out is not None:
            _save_image(
                out / "rest.png",
                camera.expose_rest(rest_state(tip), 1)[0].image,
            )
        for number, (pose, state, field) in enumerate(settled):
            displacement = state.deformation.seen
            yield Shot(
                pose=pose,
                frame=camera.expose(state, number),
                truth=truth(camera.membrane(displacement), displacement),
                seen=displacement,
                field=field,
                friction=(np.nan if field is None else whole_friction(tip, obj, state, field)),
            )


def _entry(shot: Shot, number: int) -> Entry:
    pose, field = shot.pose, shot.field
    entry: Entry = {
        "image": f"image-{number:03d}.png",
        "truth": f"truth-{number:03d}.npz",
        "preview": f"preview-{number:03d}.png",
    }
    if field is None:
        entry |= {"press_mm": pose.depth * 1e3, "shear_mm": pose.shear * 1e3}
    else:
        margin = field.safety_margin(shot.friction)
        entry |= {
            "grip_n": pose.grip,
            "load_n": pose.load,
            "normal_n": field.total_normal,
            "friction_n": field.total_friction,
            "mu": shot.friction if np.isfinite(shot.friction) else None,
            "margin": margin if np.isfinite(margin) else None,
        }
    return entry | {"markers_visible": int(shot.truth.visible.all(axis=0).sum())}


def _write(out: Path, number: int, shot: Shot) -> None:
    _save_image(out / f"image-{number:03d}.png", shot.frame.image)
    truth, field = shot.truth, shot.field
    arrays = [
        truth.pixels,
        truth.image_centres,
        truth.areas,
        truth.visible,
        truth.overlap,
        truth.centres,
        truth.normals,
        np.rint(255 * truth.masks).astype(np.uint8),
        truth.flow,
        truth.depth,
        shot.seen,
    ]
    if field is not None:
        arrays += [field.position, field.normal, field.friction, field.contact]
    named = dict(zip(ARRAYS, arrays, strict=False))
    np.savez_compressed(out / f"truth-{number:03d}.npz", **named)  # type: ignore[arg-type]


def _save_image(path: Path, image: NDArray[np.uint8]) -> None:
    if not cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR)):
        raise OSError(0, f"{path.name} was not written")
