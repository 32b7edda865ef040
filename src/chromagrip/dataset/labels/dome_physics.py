"""Laws of the labels of a dome: elasticity, depth, friction cones, the way of nodes, balance."""

from collections.abc import Iterator

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...loop.dome_world import PRESS_DRAG
from ...model import ForceField, SoftBody, Solid, margin_within
from ...model.dome import lattice
from ...model.shapes import distances
from ...sensing.contact import of_dome
from .chain_physics import missing_impulses, unbalanced_impulses
from .frames import skin_field
from .laws import Array, Stored, Table, lawful_frames, lawful_markers
from .shot import SLIPPING

Flags = NDArray[np.bool_]

#: Tolerance of directions and of friction across them, as a share of the sum of all forces, and at
#: least [N].
_SHARE, _LEAST = 1e-4, 1e-5
#: Tolerance of a node's share of the friction limit, where it is said to slip or not.
_CONE = 2e-3
#: Nodes with less than this share of all force may count as in contact or not.
_TOUCHING = 1.01e-6
#: Tolerance of the way of a node that sticks [m], and how much longer it is than `presliding` where
#: friction turns as it grows.
_STUCK, _TURNS = 1e-6, 2.0
#: Nodes whose ways are looked at: growth of the normal force, and its share of the largest.
_STEADY, _FIRM = 1.02, 0.1
#: Friction turned by less than this since the frame before: cosine.
_STRAIGHT = 0.9
#: Relative residual to which forces on the silicone are found from its displacement.
_SOLVED = 1e-7
#: Nodes this near to those that were loaded may carry what viscosity remembers [pitches].
_BESIDE = 1.6


class _Dome:
    """Places and forces of a sequence's nodes, in SI units.

    Attributes
    ----------
    places: of the nodes, shape (T, N, 3)
    seen: the same in the object's own axes, shape (T, N, 3)
    gaps, normals: of the object at each node, shapes (T, N) and (T, N, 3)
    normal, direction, friction, areas, on, slips: columns
    """

    def __init__(self, stored: Stored) -> None:
        scene, markers = stored.scene, stored.markers
        self.body: SoftBody = scene.build_dome()
        self.places = 1e-3 * stored.vectors("node_{}_mm")
        self.normal = markers["node_normal_n"].astype(float)
        self.direction = stored.vectors("node_direction_{}")
        self.friction = stored.vectors("node_friction_{}_n")
        self.areas = 1e-6 * markers["node_area_mm2"].astype(float)
        self.on, self.slips = (markers[f"node_{of}"].astype(bool) for of in ("contact", "slips"))
        self.solids = [of_dome(sample.contact)[0] for sample in stored.again]
        middle = 1e-3 * stored.vectors("object_{}_mm")
        self.turns = [
            Rotation.from_rotvec(turn).as_matrix() for turn in stored.vectors("object_turn_{}_rad")
        ]
        self.seen, self.normals = np.empty(self.places.shape), np.empty(self.places.shape)
        self.gaps = np.empty(self.normal.shape)
        for k, (solid, turn) in enumerate(zip(self.solids, self.turns, strict=True)):
            self.seen[k] = (self.places[k] - middle[k]) @ turn
            self.gaps[k], normal = distances(solid.shape, self.seen[k])
            self.normals[k] = normal @ turn.T

    def field(self, k: int) -> ForceField:
        """Contact forces of a frame."""
        return ForceField(
            position=self.places[k],
            normal=self.normal[k],
            friction=self.friction[k],
            contact=self.on[k],
            directions=self.direction[k],
            totals_covariance=np.zeros((2, 2)),
        )


def lawful_dome(stored: Stored) -> tuple[Table, Table]:
    """Values of the columns of frames and markers that follow from others and from the scene."""
    own = _Dome(stored)
    fields = [own.field(k) for k in range(len(own.on))]
    frames = lawful_frames(stored, fields, own.slips)
    forces = np.array([field.total_force for field in fields])
    axes = np.eye(3)
    torques = 1e3 * np.array([[field.torque(axis) for axis in axes] for field in fields])
    for k, name in enumerate(("grip_n", "load_n")):
        if np.isnan(frames[name]).all():  # the pose is prescribed, and forces hold it
            frames[name] = np.hypot(forces[:, 0], forces[:, 1]) if k else -forces[:, 2]
    states = [of_dome(sample.contact)[1] for sample in stored.again]
    start, way = 1e3 * states[0].place, np.array([state.place for state in states])
    turns = Rotation.from_matrix([state.rotation for state in states]).as_rotvec()
    frames["limit_margin"] = np.array(
        [margin_within(*pair) for pair in zip(fields, stored.frames["mu"], strict=True)]
    )
    frames |= {
        "object_x_mm": start[0] + stored.frames["object_mm"],
        "object_y_mm": 1e3 * way[:, 1],
        "object_z_mm": start[2] - stored.frames["rigid_part_mm"],
    }
    for k, axis in enumerate("xyz"):
        frames[f"force_{axis}_n"] = forces[:, k]
        frames[f"torque_{axis}_nmm"] = torques[:, k]
        frames[f"object_turn_{axis}_rad"] = turns[:, k]
    return frames, _markers(own, stored)


def _markers(own: _Dome, stored: Stored) -> Table:
    pressed = own.normal > 0.0
    stiffness = np.array([solid.stiffness for solid in own.solids])[:, None]
    whole = np.maximum(own.normal.sum(axis=1, keepdims=True), 1e-9)
    either = pressed & (own.normal < _TOUCHING * whole)
    carried = _carried(own)
    values = lawful_markers(stored, own.body, list(carried)) | {
        "node_contact": np.where(either, own.on, pressed),
        "node_slips": own.slips & own.on,
        "node_normal_n": stiffness * own.areas * np.maximum(0.0, -own.gaps),
        "node_area_mm2": np.broadcast_to(1e6 * lattice(own.body).areas, own.areas.shape),
    }
    direction = np.where(pressed[..., None], own.normals, 0.0)
    field, rest = skin_field(own.body), lattice(own.body).points
    places = 1e3 * np.array([rest + field(forces) for forces in carried])
    # Stiffening is along the normal alone. What viscosity remembers is no force of this frame.
    across = carried - direction * (carried * direction).sum(axis=-1, keepdims=True)
    friction = own.friction if own.body.relaxation else across
    for k, axis in enumerate("xyz"):
        values[f"node_{axis}_mm"] = places[..., k]
        values[f"node_direction_{axis}"] = direction[..., k]
        values[f"node_friction_{axis}_n"] = friction[..., k]
    return values


def _carried(own: _Dome) -> Array:
    """Forces that displace the nodes that are or were pressed as they are displaced [N], (T, N, 3).

    They are those of the linear silicone, which the skin elsewhere and all markers follow.
    """
    rest, field = lattice(own.body).points, skin_field(own.body)
    carried = np.zeros(own.places.shape)
    pressed = own.normal > 0.0
    if own.body.relaxation:
        pressed = np.logical_or.accumulate(pressed, axis=0)
        reach = _BESIDE * own.body.spacing
        tree = scipy.spatial.KDTree(rest)
        for k in range(len(pressed)):
            for beside in tree.query_ball_point(rest[pressed[k]], reach):
                pressed[k, beside] = True
    for k, loaded in enumerate(map(np.flatnonzero, pressed)):
        moved = (own.places[k] - rest)[loaded].ravel()
        if not (len(loaded) and np.isfinite(moved).all()):
            continue
        matrix = field.of_nodes(loaded)[:, :, loaded].reshape(len(moved), -1)
        first = own.normal[k, loaded, None] * own.direction[k, loaded] + own.friction[k, loaded]
        forces, _ = scipy.sparse.linalg.cg(
            scipy.sparse.linalg.aslinearoperator(matrix.T),
            moved,
            np.nan_to_num(first.ravel()),
            rtol=_SOLVED,
            maxiter=10 * len(moved),
        )
        carried[k, loaded] = forces.reshape(-1, 3)
    return carried


def wrong_dome(stored: Stored, driven: bool) -> Iterator[str]:
    """Yield frames with forces beyond friction, nodes that move against it, or out of balance.

    Parameters
    ----------
    driven: whether grip and load move the object; else its pose is prescribed
    """
    own, mu = _Dome(stored), stored.frames["mu"]
    for k in range(len(own.on)):
        for wrong in _wrong_forces(own, k, float(mu[k])):
            yield f"frame {k}: {wrong}"
        if k:
            for wrong in _wrong_way(own, k):
                yield f"frame {k}: {wrong}"
    if driven:
        yield from unbalanced_impulses(stored, *_impulses(stored))


def _wrong_forces(own: _Dome, k: int, mu: float) -> Iterator[str]:
    normal, direction, friction, on = own.normal[k], own.direction[k], own.friction[k], own.on[k]
    slack = max(_SHARE * float(abs(normal).sum()), _LEAST)
    sizes, held = np.linalg.norm(friction, axis=1), mu * normal
    if not (normal >= 0.0).all():
        yield "node_normal_n is negative on a node"
    if not (sizes <= (1.0 + _CONE) * held + slack / 100.0).all():
        yield "node_friction_x_n … on a node is more than µ times its normal force"
    if not (abs(np.linalg.norm(direction[on], axis=1) - 1.0) <= _SHARE).all():
        yield "node_direction_x … of a node's normal force is not of length 1"
    if not (abs((direction * friction).sum(axis=1)) <= slack / 10.0).all():
        yield "node_friction_x_n … on a node is not across its normal force"
    share = np.divide(sizes, held, out=np.zeros_like(sizes), where=held > 0.0)
    if (share[own.slips[k]] < SLIPPING - _CONE).any():
        least = share[own.slips[k]].min()
        yield f"node_slips of a node with {least:.3f} of the friction that it holds"
    stick = on & ~own.slips[k]
    if (share[stick] > SLIPPING + _CONE).any():
        most = share[stick].max()
        yield f"node_slips is not set of a node with {most:.3f} of the friction that it holds"


def _wrong_way(own: _Dome, k: int) -> Iterator[str]:
    """Yield nodes whose way over the object since frame k − 1 is not that of friction.

    A node that sticks stays where it is on the object, but for the way in which Dahl friction
    grows; one that slips is held back by its friction.
    """
    normal, slips, direction = own.normal, own.slips, own.direction[k]
    moved = (own.seen[k] - own.seen[k - 1]) @ own.turns[k].T
    # A node may have slipped between two frames while it was pressed less.
    steady = own.on[k] & own.on[k - 1] & (normal[k] <= _STEADY * normal[k - 1])
    steady &= normal[k] > _FIRM * normal[k].max()
    along = moved - direction * (moved * direction).sum(axis=1, keepdims=True)
    way = np.linalg.norm(along, axis=1)
    stick = steady & ~slips[k] & ~slips[k - 1]
    longest = _TURNS * presliding(own.solids[k], normal[k] / own.areas[k]) + _STUCK
    if (over := (way - longest)[stick]).size and over.max() > 0.0:
        yield f"a node without node_slips moves {1e6 * way[stick][over.argmax()]:.3g} µm"
    slid = steady & slips[k] & slips[k - 1] & (way > longest)
    before, now = own.friction[k - 1], own.friction[k]
    sizes = np.linalg.norm(before, axis=1) * np.linalg.norm(now, axis=1)
    slid &= (before * now).sum(axis=1) > _STRAIGHT * sizes
    if ((along * now).sum(axis=1)[slid] > 0.0).any():
        yield "friction pulls a node the way it slips"


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


def _impulses(stored: Stored) -> tuple[Array, Array]:
    """Impulses that grip, load, contact and dampers to ground miss: as told, and simulated."""
    column, scene, again = stored.frames, stored.scene, stored.again
    drags = np.array([scene.object.drag_n_s_per_m, PRESS_DRAG])

    def missing(force: Array, way: Array) -> Array:
        on = np.stack([column["load_n"] - force[:, 0], column["grip_n"] + force[:, 2]], axis=1)
        return missing_impulses(on, drags * way, scene.period)

    told = 1e-3 * np.stack([column["object_mm"], column["rigid_part_mm"]], axis=1)
    ways = [(sample.contact.place[0], sample.contact.indentation) for sample in again]
    forces = [sample.contact.field.total_force for sample in again]
    return (
        missing(stored.vectors("force_{}_n"), told),
        missing(np.array(forces), np.array(ways)),
    )
