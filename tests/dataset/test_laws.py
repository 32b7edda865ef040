"""Labels of freshly made sequences obey the laws of their mechanics, by the files alone."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from chromagrip.dataset import load_sequences
from chromagrip.dataset.labels import STATES
from chromagrip.dataset.make import make
from chromagrip.dataset.recipe import Recipe, load_recipe
from chromagrip.dataset.sequence import sequence, shots
from chromagrip.loop.dome_world import PRESS_DRAG
from chromagrip.model import GROSS_SLIP, chain_forces
from chromagrip.model.chain import chain, contact
from chromagrip.model.dome import lattice
from chromagrip.model.kernels import contact_frames, frictions_at
from chromagrip.model.shapes import distances
from chromagrip.scene.scene import Scene

Array = NDArray[np.float64]
CHAIN: dict[str, Any] = {
    "duration_s": 0.3, "camera": {"rate_hz": 120.0}, "fingertip": {"step_ms": 5.0, "nodes": 101},
    "actuator": {"lag_ms": 10.0},
}  # fmt: skip
DOME: dict[str, Any] = {
    "body": "dome", "duration_s": 0.1, "camera": {"rate_hz": 50.0}, "dome": {"pitch_mm": 0.9},
}  # fmt: skip
SLIP: dict[str, Any] = {
    "motion": {"choice": ["slip"]}, "grip_n": {"choice": [2.0]}, "slip_share": {"choice": [1.3]},
    "object.radius_mm": {"choice": [20.0]}, "object.friction": {"choice": [0.4]},
}  # fmt: skip
MOVE: dict[str, Any] = {
    "motion": {"choice": ["move"]}, "pose.press_share": {"choice": [0.3]},
    "pose.shear_mm": {"choice": [0.6]}, "pose.shear_towards_deg": {"choice": [70.0]},
    "pose.twist_deg": {"choice": [15.0]}, "pose.tilt_deg": {"choice": [5.0]},
}  # fmt: skip
BALL = {"object.radius_mm": {"choice": [12.0]}}
BOX = {"shape": "box", "size_mm": [20.0, 20.0, 20.0], "rounding_mm": 0.5,
       "turned_deg": [45.0, 0.0, 0.0]}  # fmt: skip
PATCHES = {"friction_places_mm": [-1.0, 0.0, 1.0], "friction_factors": [1.0, 2.0, 0.5]}
#: Scene and draws of each kind of sequence.
KINDS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "chain": (CHAIN, SLIP),
    "patches": (CHAIN | {"object": PATCHES}, SLIP),
    "dome": (DOME, SLIP),
    "move": (DOME, MOVE | BALL),
    "edges": (DOME, MOVE | {"object": {"choice": [BOX]}}),
    "pad": (DOME | {"sensor": "flat-2019", "dome": {"pitch_mm": 2.0}}, MOVE | BALL),
}
#: Of these the laws are tested quickly.
QUICK = ("chain", "dome", "move")


@dataclass(frozen=True)
class Labels:
    """Labels of a sequence: the columns of its frames and those of nodes."""

    scene: Scene
    frames: dict[str, NDArray[Any]]
    nodes: dict[str, NDArray[Any]]

    def vectors(self, name: str, axes: str = "xyz") -> Array:
        """Columns of each axis, from a name with {} for it, shape (T, …, 2 or 3)."""
        table = self.nodes if name.format("x") in self.nodes else self.frames
        return np.stack([table[name.format(axis)].astype(float) for axis in axes], axis=-1)

    @property
    def touching(self) -> NDArray[np.intp]:
        """Frames in contact."""
        return np.flatnonzero(self.frames["contact_nodes"])


@cache
def labels(kind: str) -> Labels:
    """Labels of a sequence that is made of a kind."""
    scene, draw = KINDS[kind]
    with TemporaryDirectory() as folder:
        make(Recipe(sequences=1, scene=scene, draw=draw), Path(folder) / "data")
        (one,) = load_sequences(Path(folder) / "data")
    return Labels(one.scene, one.frames, one.markers)


def near(found: Array, law: Array, tolerance: float) -> None:
    """Values are those of a law within a share of the largest of them, or as float32 has them."""
    assert np.isfinite(found).all()
    assert abs(found - law).max(initial=0.0) <= tolerance * abs(law).max(initial=0.0) + 1e-8


def sums(of: Labels) -> None:
    """Γ and the state of slip follow from sums over the nodes in contact."""
    frames, on = of.frames, of.nodes["node_contact"].astype(bool)
    normal = np.where(on, of.nodes["node_normal_n"], 0.0)
    assert (frames["contact_nodes"] == on.sum(axis=1)).all()
    at = of.touching
    assert len(at) > 3
    assert np.isnan(frames["margin"][frames["contact_nodes"] == 0]).all()
    friction, held = frames["friction_n"][at], frames["mu"][at] * frames["normal_n"][at]
    near(frames["margin"][at], 1.0 - friction / held, 1e-9)
    share = frames["slipped_share"]
    expected = np.where(share > 0.0, STATES[2], STATES[1]).astype(object)
    expected[frames["lateral_displacement_mm"] > 1e3 * GROSS_SLIP] = STATES[3]
    assert (frames["slip_state"][at] == expected[at]).all()
    if of.scene.body == "chain":
        near(frames["normal_n"], normal.sum(axis=1), 1e-6)
        friction = np.where(on, of.nodes["node_friction_n"], 0.0).sum(axis=1)
        near(frames["friction_n"], abs(friction), 1e-6)
        return
    forces = normal[..., None] * of.vectors("node_direction_{}")
    forces += np.where(on[..., None], of.vectors("node_friction_{}_n"), 0.0)
    near(of.vectors("force_{}_n"), forces.sum(axis=1), 1e-5)
    torque = np.cross(of.vectors("node_{}_mm"), forces).sum(axis=1)
    near(of.vectors("torque_{}_nmm"), torque, 1e-5)
    near(share[at], (of.nodes["node_slips"] & on).sum(axis=1)[at] / on.sum(axis=1)[at], 1e-9)


def chain_contact(of: Labels) -> tuple[Array, Array, Array, Array]:
    """Depth forces and limits µ·Fn of a chain's nodes (T, N), and its surface's normals there.

    Also the nodes' places in the ground frame, shape (T, N, 2).
    """
    tip = of.scene.build_fingertip()
    ground = 1e-3 * of.vectors("node_{}_mm", "xz")
    ground[..., 1] += 1e-3 * of.frames["rigid_part_mm"][:, None]
    moved, normal = 1e-3 * of.frames["object_mm"], of.nodes["node_normal_n"]
    depth, held, normals = np.empty(normal.shape), np.empty(normal.shape), np.empty(ground.shape)
    ct = contact(tip, of.scene.build_object())
    for k in range(len(moved)):
        gap, normals[k] = contact_frames(ct, ground[k], moved[k])
        depth[k] = ct.stiffness * chain(tip).share * np.maximum(0.0, -gap)
        held[k] = frictions_at(ct, ground[k, :, 0] - moved[k]) * normal[k]
    return depth, held, normals, ground


def chain_cones(of: Labels) -> None:
    """Normal forces follow from depth in the object, friction stays within Coulomb's cone."""
    depth, held, _, _ = chain_contact(of)
    near(of.nodes["node_normal_n"], depth, 2e-5)
    friction = abs(of.nodes["node_friction_n"])
    assert (friction <= held + 1e-6 * held.max()).all()
    on = of.nodes["node_contact"].astype(bool)
    told = of.frames["slipped_share"] * on.sum(axis=1)
    for least, sign in ((0.98 + 1e-4, 1.0), (0.98 - 1e-4, -1.0)):  # a node may be at the limit
        assert (sign * (told - (on & (friction >= least * held)).sum(axis=1)) > -0.5).all()


def chain_balance(of: Labels) -> None:
    """Springs balance contact on each node, and dampers the rest of grip and load, as motion ends.

    Nodes have no inertia. The first frames, in which the grip jumps, are left out.
    """
    tip, frames = of.scene.build_fingertip(), of.frames
    ch, obj = chain(tip), of.scene.build_object()
    _, _, normals, ground = chain_contact(of)
    tangents = np.stack([-normals[..., 1], normals[..., 0]], axis=-1)
    pressed = of.nodes["node_normal_n"][..., None] * normals
    rubbed = of.nodes["node_friction_n"][..., None] * tangents
    seen = 1e-3 * of.vectors("node_{}_mm", "xz") - tip.rest_positions()
    springs = np.stack([chain_forces(tip, one) for one in seen])
    late = slice(6, None)
    near(springs[late, 1:-1], (pressed + rubbed)[late, 1:-1], 0.02)
    travel = contact(tip, obj).travel
    x = frames["load_n"] - (travel * pressed + rubbed).sum(axis=1)[:, 0]
    z = frames["grip_n"] + (pressed + rubbed).sum(axis=1)[:, 1]
    inner = ground[:, 1:-1, 1] - tip.rest_positions()[1:-1, 1]
    drag = inner @ ch.damping[1:-1] + ch.damping_rigid * 1e-3 * frames["rigid_part_mm"]
    impulses(of, np.stack([x, z], axis=1), obj.drag * 1e-3 * frames["object_mm"], drag, late)


def impulses(of: Labels, force: Array, along: Array, across: Array, late: slice) -> None:
    """Impulses of forces between frames are those of dampers, whose way times drag is given."""
    mean = (force[1:] + force[:-1]) / 2.0
    damped = np.diff(np.stack([along, across], axis=1), axis=0) / of.scene.period
    assert abs(damped - mean)[late].max() < 0.02 * of.frames["grip_n"].max()


def dome_cones(of: Labels) -> None:
    """Normal forces follow from depth, along the object's normal; friction across in its cone."""
    solid, on = of.scene.build_solid(), of.nodes["node_contact"].astype(bool)
    normal = of.nodes["node_normal_n"].astype(float)
    direction, friction = of.vectors("node_direction_{}"), of.vectors("node_friction_{}_n")
    turns = Rotation.from_rotvec(of.vectors("object_turn_{}_rad")).as_matrix()
    middle, areas = of.vectors("object_{}_mm"), 1e-6 * of.nodes["node_area_mm2"].astype(float)
    near(areas, np.broadcast_to(lattice(of.scene.build_dome()).areas, areas.shape), 1e-6)
    for k in of.touching:
        seen = 1e-3 * (of.vectors("node_{}_mm")[k] - middle[k]) @ turns[k]
        gap, own = distances(solid.shape, seen)
        near(normal[k], solid.stiffness * areas[k] * np.maximum(0.0, -gap), 2e-5)
        pressed, most = normal[k] > 0.0, normal[k].max()
        near(direction[k, pressed], (own @ turns[k].T)[pressed], 2e-5)
        assert abs((direction[k] * friction[k]).sum(axis=1)).max() < 1e-6 * most
        size, held = np.linalg.norm(friction[k], axis=1), of.frames["mu"][k] * normal[k]
        assert (size <= held + 1e-6 * most).all()
        share = (size / np.maximum(held, 1e-12))[on[k]]
        slips = of.nodes["node_slips"][k][on[k]]
        assert (slips == (share >= 0.98))[abs(share - 0.98) > 1e-4].all()


def dome_balance(of: Labels) -> None:
    """Grip and load, or what holds a pose, are balanced by contact and dampers."""
    frames, force = of.frames, of.vectors("force_{}_n")
    if not of.scene.load.forces_n:
        near(frames["grip_n"], -force[:, 2], 1e-6)
        near(frames["load_n"], np.hypot(force[:, 0], force[:, 1]), 1e-6)
        return
    drive = np.stack([frames["load_n"], frames["grip_n"]], axis=1)
    along = of.scene.object.drag_n_s_per_m * 1e-3 * frames["object_mm"]
    across = PRESS_DRAG * 1e-3 * frames["rigid_part_mm"]
    impulses(of, drive + force[:, [0, 2]] * [-1.0, 1.0], along, across, slice(2, None))


#: Laws of a body.
LAWS: dict[str, tuple[Any, ...]] = {
    "chain": (sums, chain_cones, chain_balance),
    "dome": (sums, dome_cones, dome_balance),
}


@pytest.mark.parametrize(
    "kind",
    [kind if kind in QUICK else pytest.param(kind, marks=pytest.mark.data) for kind in KINDS],
)
def test_labels_obey_their_laws(kind: str) -> None:
    for law in LAWS[labels(kind).scene.body]:
        law(labels(kind))


def test_a_slip_goes_through_all_states() -> None:
    draw = {
        "motion": {"choice": ["slip"]}, "grip_n": {"choice": [2.0]},
        "slip_share": {"choice": [1.5]}, "object.friction": {"choice": [0.4]},
    }  # fmt: skip
    scene = load_recipe("tiny").scene | {"duration_s": 1.0, "camera": {"rate_hz": 20.0}}
    recipe = Recipe(scene=scene, draw=draw)
    states = [shot.values["slip_state"] for shot in shots(recipe, sequence(recipe, 0))[1]]
    order = [state for k, state in enumerate(states) if k == 0 or states[k - 1] != state]
    assert order[-2:] == ["incipient", "gross"]
    assert order[0] == "none"
