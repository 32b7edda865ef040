"""`chromagrip render`: pictures of poses with their ground truth, in a folder of files."""

import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...folders import prepared
from ...model import DomeState, State, margin_within, rest_state
from ...model.dome import displacements, lattice
from ...output.processes import one_thread
from ...output.versions import versions
from ...render import TruthMap, camera_text
from ...scene.scene import Scene
from ...sensing.camera import carried
from ...sensing.sensor import open_camera
from ..run_files import scene_text
from .dome_poses import DomePose
from .poses import Pose, Settled, Shot, settle_any
from .preview import draw_preview

FORMAT = "chromagrip render 1"
#: First line of the scene.
_SCENE = "Everything these pictures were made from but their poses, which are in poses.json"
#: Folder of the previews: beside the images they would be read as frames of another size.
PREVIEWS = "previews"
#: Decimals of forces [N] and torques [N·mm] of a dome; further ones are the solver's.
_FORCE_DIGITS, _TORQUE_DIGITS = 5, 4

#: One picture of `poses.json`: names of its files, and forces or displacements.
Entry = dict[str, str | float | list[float] | None]


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


#: Share of the friction limit above which a node of a dome slips.
SLIPPING = 0.999

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
#: The same of a dome of silicone.
DOME_ARRAYS = {
    name: said for name, said in ARRAYS.items() if not name.startswith(("seen", "force"))
}
DOME_ARRAYS |= {
    "seen_m": "displacement (x, y, z) of each node of the skin, (N, 3)",
    "force_position_m": "place (x, y, z) of each node of the pressed skin, (N, 3)",
    "force_normal_n": "normal force of the object on each node, (N,)",
    "force_friction_n": "friction on each node, (N, 3)",
    "force_contact": "node is in contact, (N,)",
    "force_direction": "unit normal of the object at each node in contact, 0 elsewhere, (N, 3)",
    "force_area_m2": "area of the skin that each node stands for, (N,)",
    "force_slips": "node is in contact and slips, (N,)",
    "object_place_m": "place of the object's own origin, (3,)",
    "object_rotation": "of the object's own axes to the sensor's, (3, 3)",
    "traction_pa": "force of the object per area of skin that each pixel shows, (H, W, 3)",
    "contact_mask": "pixel shows skin in contact, (H, W)",
}


def render_poses(
    scene: Scene,
    poses: Sequence[Pose | DomePose],
    out: Path | None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
    again: str | None = None,
) -> Report:
    """Take a picture of each pose; with a folder, write them with their truth and previews.

    Parameters
    ----------
    scene: object, fingertip, sensor, renderer, defects, noise and seed
    poses: of the fingertip
    out: folder, made if missing
    overwrite: write into a folder that is not empty, over an earlier result
    progress: called after every picture
    again: command that takes the same pictures of the scene.toml that is written

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
        settled.append(settle_any(scene, pose))
        progress(0, len(poses))
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
                    "scene.toml": "everything this was made from but the poses",
                    "camera.yml": "the camera, in OpenCV's format",
                    "rest.png": "the unloaded sensor, same specimen and noise",
                },
                "arrays": ARRAYS if scene.body == "chain" else DOME_ARRAYS,
                "poses": entries,
                "versions": versions(),
            }
            if out is not None:
                said = _SCENE + (f"; {again} takes them again" if again else "")
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


def _shots(scene: Scene, settled: list[Settled], out: Path | None) -> Iterator[Shot]:
    """Pictures of settled poses, in order; the rest frame is written on the way."""
    sensor, chain = scene.build_sensor(), scene.body == "chain"
    truth = TruthMap(sensor, scene.fingertip.nodes if chain else scene.build_dome())
    rest = rest_state(scene.build_fingertip()) if chain else _untouched(settled[0].state)
    with closing(open_camera(scene)) as camera, one_thread():
        still = carried(rest)
        depth = truth(camera.membrane(still), still).depth
        if out is not None:
            _save_image(out / "rest.png", camera.expose_rest(rest, 1)[0].image)
        for number, one in enumerate(settled):
            drive, frame = carried(one.state), camera.expose(one.state, number)
            seen, traction = drive, None
            if isinstance(one.state, DomeState):
                dome = scene.build_dome()
                seen = displacements(dome, one.state)
                traction = truth.skin_image(drive, one.state.forces / lattice(dome).areas[:, None])
            yield Shot(
                settled=one,
                frame=frame,
                truth=truth(camera.membrane(drive), drive),
                rest_depth=depth,
                seen=seen,
                traction=traction,
            )


def _untouched(state: State | DomeState) -> DomeState:
    """A dome that nothing deforms."""
    assert isinstance(state, DomeState)
    nothing = np.zeros_like(state.linear)
    return replace(state, time=0.0, linear=nothing, memory=nothing)


def _entry(scene: Scene, shot: Shot, number: int) -> Entry:
    pose, field, friction = shot.settled.pose, shot.settled.field, shot.settled.friction
    entry: Entry = {
        "image": f"image-{number:03d}.png",
        "truth": f"truth-{number:03d}.npz",
        "preview": f"{PREVIEWS}/preview-{number:03d}.png",
    }
    if isinstance(pose, DomePose):
        entry |= _dome_pose(pose)
    elif field is None:
        entry |= {"press_mm": pose.depth * 1e3, "shear_mm": pose.shear * 1e3}
    else:
        entry |= {"grip_n": pose.grip, "load_n": pose.load}
    if field is not None:
        digits = _FORCE_DIGITS if isinstance(pose, DomePose) else None
        margin = field.safety_margin(friction)
        entry |= {
            "normal_n": _rounded(field.total_normal, digits),
            "friction_n": _rounded(field.total_friction, digits),
            "mu": friction if np.isfinite(friction) else None,
            "margin": _rounded(margin, digits) if np.isfinite(margin) else None,
        }
        if isinstance(pose, DomePose):
            limit = margin_within(field, friction)
            torque = [1e3 * field.torque(axis) for axis in np.eye(3)]
            outwards = lattice(scene.build_dome()).outwards
            deepest = -1e3 * float(np.einsum("ij,ij->i", shot.seen, outwards).min())
            entry |= {
                "limit_margin": _rounded(limit, digits) if np.isfinite(limit) else None,
                "force_n": [_rounded(force, digits) for force in field.total_force.tolist()],
                "torque_nmm": [_rounded(part, _TORQUE_DIGITS) for part in torque],
                "deepest_mm": _rounded(deepest, 4),
            }
    return entry | {"markers_visible": int(shot.truth.visible.all(axis=0).sum())}


def _rounded(value: float, digits: int | None) -> float:
    """Value to so many decimals, and no negative zero."""
    return value if digits is None else round(value, digits) + 0.0


def _dome_pose(pose: DomePose) -> Entry:
    """How an object was put on a dome."""
    entry: Entry = {
        "tilt_deg": np.degrees(pose.tilt).tolist(),
        "azimuth_deg": math.degrees(pose.azimuth),
    }
    if pose.force is None:
        entry |= {"press_mm": 1e3 * pose.press, "shear_mm": [1e3 * s for s in pose.shear]}
    else:
        entry["load_n"] = list(pose.force)
    if pose.moment is None:
        entry["twist_deg"] = math.degrees(pose.twist)
    else:
        entry["moment_nmm"] = 1e3 * pose.moment
    return entry


def _write(out: Path, number: int, shot: Shot, scene: Scene) -> None:
    _save_image(out / f"image-{number:03d}.png", shot.frame.image)
    truth, field = shot.truth, shot.settled.field
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
    names = ARRAYS
    if isinstance(shot.settled.state, DomeState):
        names, state = DOME_ARRAYS, shot.settled.state
        assert shot.traction is not None
        assert field is not None
        assert field.directions is not None
        slips = field.friction_sizes > SLIPPING * shot.settled.friction * field.normal
        pixels = np.nan_to_num(abs(shot.traction)).max(axis=-1)
        arrays += [
            field.directions, lattice(scene.build_dome()).areas, slips & field.contact, state.place,
            state.rotation, shot.traction, pixels > 0.0,
        ]  # fmt: skip
    named = dict(zip(names, arrays, strict=False))
    np.savez_compressed(out / f"truth-{number:03d}.npz", **named)  # type: ignore[arg-type]


def _save_image(path: Path, image: NDArray[np.uint8]) -> None:
    if not cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR)):
        raise OSError(0, f"{path.name} was not written")
