"""Physics of the labels of a dome: forces, moments, friction cones, the object's place, slip."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...loop.dome_world import PRESS_DRAG
from ...model import Solid
from ...model.shapes import distances
from ...scene.scene import Scene
from .shot import SLIPPING
from .sums import wrong_sums

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Tolerance of forces, as a share of the sum of all, and at least [N].
_SHARE, _LEAST = 1e-4, 1e-5
#: Tolerance of a node's share of the friction limit, where it is said to slip or not.
_CONE = 2e-3
#: Forces are as deep in the object as its stiffness says: tolerance [m], and share of the depth to
#: which steps are solved.
_DEPTH, _SOLVED = 0.2e-6, 1e-3
#: Tolerance of the way of a node that sticks [m], and how much longer it is than `presliding` where
#: friction turns as it grows.
_STUCK, _TURNS = 1e-6, 2.0
#: Nodes whose ways are looked at: growth of the normal force, and its share of the largest.
_STEADY, _FIRM = 1.02, 0.1
#: Tolerance of the balance of forces, as a share of the largest grip or load.
_BALANCE = 0.05


def _vectors(own: dict[str, NDArray[Any]], name: str) -> Array:
    """Columns x, y and z of a name with a hole for the axis, (…, 3)."""
    return np.stack([own[name.format(axis)].astype(float) for axis in "xyz"], axis=-1)


def _vector(row: dict[str, Any], name: str) -> Array:
    return np.array([row[name.format(axis)] for axis in "xyz"], float)


def wrong_dome(row: dict[str, Any], own: dict[str, NDArray[Any]]) -> Iterator[str]:
    """Yield what is wrong with the forces of a frame."""
    normal, touching = own["node_normal_n"].astype(float), own["node_contact"].astype(bool)
    direction, friction = _vectors(own, "node_direction_{}"), _vectors(own, "node_friction_{}_n")
    places = _vectors(own, "node_{}_mm")
    slack = max(_SHARE * float(abs(normal).sum()), _LEAST)
    sizes, held = np.linalg.norm(friction, axis=1), row["mu"] * normal
    if (normal < 0.0).any():
        yield "a node's normal force is negative"
    if (sizes > (1.0 + _CONE) * held + slack / 100.0).any():
        yield "friction on a node is more than µ times its normal force"
    if (abs(np.linalg.norm(direction[touching], axis=1) - 1.0) > _SHARE).any():
        yield "the direction of a node's normal force is not of length 1"
    if (abs((direction * friction).sum(axis=1)) > slack / 10.0).any():
        yield "friction on a node is not across its normal force"
    yield from _wrong_slip(own["node_slips"].astype(bool), touching, sizes, held)
    forces = normal[:, None] * direction + friction
    torque = np.cross(places, forces).sum(axis=0)
    yield from _wrong_vector(row, "force_{}_n", forces.sum(axis=0), slack)
    # An arm is at most as long as the sphere's radius.
    arm = float(np.linalg.norm(places, axis=1).max(initial=1.0))
    yield from _wrong_vector(row, "torque_{}_nmm", torque, slack * arm)
    net = friction[touching].sum(axis=0)
    axis = normal[touching] @ direction[touching]
    if (length := float(np.linalg.norm(axis))) > 0.0:
        net = net - axis * (net @ axis) / length**2
    sums = float(normal[touching].sum()), float(np.linalg.norm(net))
    yield from wrong_sums(row, touching, *sums, slack)


def _wrong_slip(slips: Flags, touching: Flags, sizes: Array, held: Array) -> Iterator[str]:
    """Yield nodes whose friction is not that of a node that slips, or sticks."""
    share = np.divide(sizes, held, out=np.zeros_like(sizes), where=held > 0.0)
    if (slips & ~touching).any():
        yield "a node slips out of contact"
    if (share[slips] < SLIPPING - _CONE).any():
        yield f"a node slips with {share[slips].min():.3f} of the friction that it holds"
    stick = touching & ~slips
    if (share[stick] > SLIPPING + _CONE).any():
        yield f"a node sticks with {share[stick].max():.3f} of the friction that it holds"


def _wrong_vector(row: dict[str, Any], name: str, sums: Array, slack: float) -> Iterator[str]:
    for axis, said, total in zip("xyz", _vector(row, name), sums, strict=True):
        if not abs(said - total) <= slack:
            yield f"{name.format(axis)} is {said:.6g}, the nodes' sum {total:.6g}"


def wrong_motion(
    scene: Scene, frames: dict[str, list[Any]], columns: dict[str, NDArray[Any]], driven: bool
) -> Iterator[str]:
    """Yield frames whose forces do not fit the place of the object, or the motion to it.

    A node is in the object as deep as its normal force and the object's stiffness say. One that
    sticks stays where it is on the object, but for the way in which Dahl friction grows; one that
    slips is held back by its friction.

    Parameters
    ----------
    driven: whether grip and load move the object; else its pose is prescribed
    """
    places = 1e-3 * _vectors(columns, "node_{}_mm")
    normal = columns["node_normal_n"].astype(float)
    areas = 1e-6 * columns["node_area_mm2"].astype(float)
    on = columns["node_contact"].astype(bool)
    before: Array | None = None
    for k, time in enumerate(frames["time_s"]):
        solid = scene.build_solid(time)
        row = {name: values[k] for name, values in frames.items()}
        turn = Rotation.from_rotvec(_vector(row, "object_turn_{}_rad")).as_matrix()
        seen = (places[k] - 1e-3 * _vector(row, "object_{}_mm")) @ turn
        gap, _ = distances(solid.shape, seen)
        deep = normal[k] / (solid.stiffness * areas[k])
        off = np.where(on[k], gap + deep, np.minimum(gap + deep, 0.0))
        if (abs(off) > _DEPTH + _SOLVED * deep).any():
            worst = float(abs(off).max())
            yield f"frame {k}: a node is {1e6 * worst:.2g} µm beside where its force says"
        if before is not None:
            moved = (seen - before) @ turn.T
            # A node may have slipped between two frames while it was pressed less.
            steady = on[k] & on[k - 1] & (normal[k] <= _STEADY * normal[k - 1])
            steady &= normal[k] > _FIRM * normal[k].max()
            yield from _wrong_way(solid, k, moved, normal[k] / areas[k], columns, steady)
        before = seen
    if driven:
        yield from _unbalanced(scene, frames)


def _wrong_way(
    solid: Solid,
    k: int,
    moved: Array,
    pressure: Array,
    columns: dict[str, NDArray[Any]],
    steady: Flags,
) -> Iterator[str]:
    """Yield nodes whose way over the object since frame k − 1 is not that of friction.

    Parameters
    ----------
    moved: way of the nodes in the object's frame [m], (N, 3)
    steady: nodes in contact in both frames that are pressed no more than before, (N,)
    """
    slips = columns["node_slips"].astype(bool)
    own = {name: column[k] for name, column in columns.items() if name.startswith("node_")}
    direction, friction = _vectors(own, "node_direction_{}"), _vectors(own, "node_friction_{}_n")
    along = moved - direction * (moved * direction).sum(axis=1, keepdims=True)
    way = np.linalg.norm(along, axis=1)
    stick = steady & ~slips[k] & ~slips[k - 1]
    longest = _TURNS * presliding(solid, pressure) + _STUCK
    if (over := (way - longest)[stick]).size and over.max() > 0.0:
        yield f"frame {k}: a node sticks, and moves {1e6 * way[stick][over.argmax()]:.3g} µm"
    slid = steady & slips[k] & slips[k - 1] & (way > longest)
    if ((along * friction).sum(axis=1)[slid] > 0.0).any():
        yield f"frame {k}: friction pulls a node the way it slips"


def presliding(solid: Solid, pressure: Array) -> Array:
    """Longest way of a node over an object while it sticks [m]: Dahl friction from −µp to 0.98 µp.

    Parameters
    ----------
    pressure: on the nodes [Pa], (N,)
    """
    n, limit = solid.dahl_exponent, solid.friction * pressure / solid.dahl_stiffness
    if n == 1.0:
        return np.asarray(limit * np.log(2.0 / (1.0 - SLIPPING)))
    return np.asarray(limit * (2.0 ** (1.0 - n) - (1.0 - SLIPPING) ** (1.0 - n)) / (1.0 - n))


def _unbalanced(scene: Scene, frames: dict[str, list[Any]]) -> Iterator[str]:
    """Yield frames in which grip, load, contact and the dampers to ground do not balance.

    Impulses over each interval are compared, as a damper's force follows from a motion.
    """
    if scene.frames < 3:
        return
    column = {name: np.array(frames[name], float) for name in frames if name != "slip_state"}
    on = np.stack(
        [column["load_n"] - column["force_x_n"], column["grip_n"] + column["force_z_n"]], axis=1
    )
    drags = np.array([scene.object.drag_n_s_per_m, PRESS_DRAG])
    at = 1e-3 * drags * np.stack([column["object_mm"], column["rigid_part_mm"]], axis=1)
    off = abs(np.diff(at, axis=0) / scene.period - (on[1:] + on[:-1]) / 2)
    # The mean of both ends is off by a twelfth of the second difference.
    bend = np.pad(abs(np.diff(on, 2, axis=0)), ((1, 1), (0, 0)), mode="edge")
    off -= np.maximum(bend[1:], bend[:-1]) / 12.0
    off -= _BALANCE * max(*frames["grip_n"], *np.abs(frames["load_n"]))
    for k, axis in np.argwhere(off[1:] > 0.0):
        yield f"frame {k + 2}: forces along {'xz'[axis]} do not balance since the frame before"
