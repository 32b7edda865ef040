"""`chromagrip render`: pictures of poses with their ground truth, in a folder of files."""

import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import TypedDict

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...folders import prepared
from ...output.processes import one_thread
from ...output.versions import versions
from ...render import TruthMap, camera_text
from ...scene.scene import Scene
from ...sensing.sensor import TactileSensor
from ..run_files import scene_text
from .poses import AnyPose, Entry, Settled, Shot
from .preview import draw_preview

FORMAT = "chromagrip render 1"
#: Folder of the previews, so that they are not read as frames of another size.
PREVIEWS = "previews"


class Report(TypedDict):
    """Contents of `poses.json`."""

    format: str
    sensor: str
    renderer: str
    again: str | None
    files: dict[str, str]
    arrays: dict[str, str]
    poses: list[Entry]
    versions: dict[str, str]


def render_poses(
    scene: Scene,
    poses: Sequence[AnyPose],
    out: Path | None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
    again: str | None = None,
) -> Report:
    """Render each pose; with a folder, write pictures, ground truth and previews.

    Parameters
    ----------
    scene: scene with object, fingertip, sensor, renderer, defects, noise and seed
    poses: poses of the object
    out: folder, made if missing; None: no files are written
    overwrite: whether to write into a folder that is not empty, over an earlier result
    progress: function called after every picture with the number of pictures done and of all
    again: command that renders the same pictures from the written scene.toml

    Returns
    -------
    contents of `poses.json`

    Raises
    ------
    UserError
        For a pose, a folder or a renderer that cannot be used.
    """
    if not poses:
        raise UserError("render_poses needs at least one pose")
    # Every pose is settled first, so that no half-written folder remains if one is refused.
    settled = []
    for pose in poses:
        settled.append(pose.settled(scene))
        progress(0, len(poses))
    # First line of the scene.
    begin = "Everything these pictures were made from except their poses, which are in poses.json"
    with prepared(out, overwrite):
        if out is not None:
            (out / PREVIEWS).mkdir(exist_ok=True)
            (out / "poses.json").unlink(missing_ok=True)
        entries = []
        try:
            for number, shot in enumerate(_shots(scene, settled, out)):
                entries.append(_entry(scene, shot, number))
                if out is not None:
                    _write(out, number, shot, scene)
                    draw_preview(scene, shot, out / str(entries[-1]["preview"]))
                progress(number + 1, len(poses))
            report: Report = {
                "format": FORMAT,
                "sensor": scene.sensor,
                "renderer": scene.renderer,
                "again": again,
                "files": {
                    "scene.toml": "everything this was made from except the poses",
                    "camera.yml": "the camera, in OpenCV's format",
                    "rest.png": "the unloaded sensor, same specimen and noise",
                },
                "arrays": poses[0].arrays,
                "poses": entries,
                "versions": versions(),
            }
            if out is not None:
                said = begin + (f"; {again} takes them again" if again else "")
                (out / "scene.toml").write_text(scene_text(scene, said), encoding="utf-8")
                camera = camera_text(scene.build_sensor().view.camera)
                (out / "camera.yml").write_text(camera, encoding="utf-8")
                # Last, so that a folder that has it is complete.
                (out / "poses.json").write_text(
                    json.dumps(report, indent=2) + "\n", encoding="utf-8"
                )
        except OSError as error:
            raise UserError(f"folder {out} cannot be written: {error.strerror}") from None
    return report


def true_values(folder: Path) -> dict[str, NDArray[np.float64]]:
    """True values of the pictures of such a folder by their column of estimates; NaN if unknown.

    Raises
    ------
    UserError
        For a damaged poses.json.
    """
    try:
        poses = json.loads((folder / "poses.json").read_text(encoding="utf-8"))["poses"]
        return {
            name: np.array(
                [math.nan if pose.get(name) is None else float(pose[name]) for pose in poses]
            )
            for name in ("normal_n", "friction_n", "mu", "margin")
        }
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise UserError(f"{folder / 'poses.json'} is damaged: {error}") from None


def _shots(scene: Scene, settled: list[Settled], out: Path | None) -> Iterator[Shot]:
    """Render settled poses in order; the rest frame is written first."""
    sensor = TactileSensor.of_scene(scene)
    truth, rest = TruthMap(sensor.design, sensor.body.carrier), sensor.body.untouched()
    with closing(sensor.camera) as camera, one_thread():
        still = rest.carried
        depth = truth(camera.membrane(still), still).depth
        if out is not None:
            _save_image(out / "rest.png", camera.expose_rest(rest, 1)[0].image)
        for number, one in enumerate(settled):
            drive, frame = one.state.carried, camera.expose(one.state, number)
            seen, traction = one.pose.seen(scene, one, truth, drive)
            yield Shot(
                settled=one,
                frame=frame,
                truth=truth(camera.membrane(drive), drive),
                rest_depth=depth,
                seen=seen,
                traction=traction,
            )


def _entry(scene: Scene, shot: Shot, number: int) -> Entry:
    pose = shot.settled.pose
    return {
        "image": f"image-{number:03d}.png",
        "truth": f"truth-{number:03d}.npz",
        "preview": f"{PREVIEWS}/preview-{number:03d}.png",
        **pose.entry(shot.settled),
        **pose.sums(scene, shot),
        "markers_visible": int(shot.truth.visible.all(axis=0).sum()),
    }


def _write(out: Path, number: int, shot: Shot, scene: Scene) -> None:
    _save_image(out / f"image-{number:03d}.png", shot.frame.image)
    truth, pose = shot.truth, shot.settled.pose
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
        *pose.further(scene, shot),
    ]
    named = dict(zip(pose.arrays, arrays, strict=False))
    np.savez_compressed(out / f"truth-{number:03d}.npz", **named)


def _save_image(path: Path, image: NDArray[np.uint8]) -> None:
    if not cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR)):
        raise OSError(0, f"{path.name} was not written")
