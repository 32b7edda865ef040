"""Laws that a dome's labels must obey: elasticity, depth, friction cones, slip, force balance."""

from collections.abc import Iterator
from typing import Self

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


class _Dome:
    """Positions and forces of a dome's N nodes in the T frames of a sequence, in SI units.

    Parameters
    ----------
    stored: labels and scene of the sequence
    places: positions of the nodes, shape (T, N, 3)
    middle, turns: position and rotation of the object, shapes (T, 3) and (T, 3, 3)
    normal, areas: normal force and area of each node, shape (T, N)
    on, slips: whether each node is in contact, and whether it slips, shape (T, N)
    direction: unit direction of the normal force on each node, shape (T, N, 3)
    friction: friction force on each node, shape (T, N, 3)

    Attributes
    ----------
    seen: positions of the nodes in the object's own axes, shape (T, N, 3)
    normals: unit normals of the object at pressed nodes, 0 elsewhere, shape (T, N, 3)
    depth: normal force that follows from the penetration of each node, shape (T, N)
    """

    def __init__(
        self, stored: Stored, places: Array, middle: Array, turns: Array, normal: Array,
        areas: Array, on: Flags, slips: Flags, direction: Array, friction: Array,
    ) -> None:  # fmt: skip
        self.body: SoftBody = stored.scene.build_dome()
        self.places, self.turns, self.areas = places, turns, areas
        self.normal, self.direction, self.friction = normal, direction, friction
        self.on, self.slips = on, slips
        self.solids = [of_dome(sample.contact)[0] for sample in stored.again]
        self.seen, self.normals = np.empty(places.shape), np.empty(places.shape)
        self.depth = np.empty(normal.shape)
        for k, solid in enumerate(self.solids):
            self.seen[k] = (places[k] - middle[k]) @ turns[k]
            gap, own = distances(solid.shape, self.seen[k])
            self.normals[k] = np.where(normal[k, :, None] > 0.0, own @ turns[k].T, 0.0)
            self.depth[k] = solid.stiffness * areas[k] * np.maximum(0.0, -gap)

    @classmethod
    def told(cls, stored: Stored) -> Self:
        """Read positions and forces from the labels of the dataset."""
        markers = stored.markers
        turns = stored.vectors("object_turn_{}_rad")
        return cls(
            stored,
            1e-3 * stored.vectors("node_{}_mm"),
            1e-3 * stored.vectors("object_{}_mm"),
            np.array([Rotation.from_rotvec(turn).as_matrix() for turn in turns]),
            markers["node_normal_n"].astype(float),
            1e-6 * markers["node_area_mm2"].astype(float),
            markers["node_contact"],
            markers["node_slips"],
            stored.vectors("node_direction_{}"),
            stored.vectors("node_friction_{}_n"),
        )

    @classmethod
    def simulated(cls, stored: Stored) -> Self:
        """Take positions and forces from the scene simulated again; far nodes are at rest.

        Their deviations from the laws set the tolerances.
        """
        states = [of_dome(sample.contact)[1] for sample in stored.again]
        fields = [sample.contact.field for sample in stored.again]
        normal = np.array([field.normal for field in fields])
        on = np.array([field.contact for field in fields])
        sizes = np.array([field.friction_sizes for field in fields])
        held = np.array([sample.contact.friction for sample in stored.again])[:, None] * normal
        return cls(
            stored,
            np.array([field.position for field in fields]),
            np.array([state.place for state in states]),
            np.array([state.rotation for state in states]),
            normal,
            np.broadcast_to(lattice(stored.scene.build_dome()).areas, normal.shape),
            on,
            on & (sizes >= SLIPPING * held),
            np.array([field.directions for field in fields]),
            np.array([field.friction for field in fields]),
        )

    def field(self, k: int) -> ForceField:
        """Contact forces of frame k."""
        return ForceField(
            position=self.places[k],
            normal=self.normal[k],
            friction=self.friction[k],
            contact=self.on[k],
            directions=self.direction[k],
            totals_covariance=np.zeros((2, 2)),
        )


def lawful_dome(stored: Stored) -> tuple[Table, Table]:
    """Compute the values that the laws demand of the columns of frames and of markers."""
    own = _Dome.told(stored)
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
    """Compute the values that the laws demand of the columns of markers and nodes."""
    pressed, again = own.normal > 0.0, _Dome.simulated(stored)
    whole = np.maximum(own.normal.sum(axis=1, keepdims=True), 1e-9)
    # Nodes with less than this share of all force may count as in contact or not.
    touching = 1.01e-6
    either = pressed & (own.normal < touching * whole)
    known = np.stack([of_dome(sample.contact)[1].carried for sample in stored.again])
    forces = _carried(own, np.asarray(known.any(axis=-1)))
    field, rest = skin_field(own.body), lattice(own.body).points
    values = lawful_markers(stored, own.body, list(forces)) | {
        "node_contact": np.where(either, own.on, pressed),
        "node_slips": own.slips & own.on,
        "node_normal_n": _open(own.normal, own.depth, again.depth - again.normal),
        "node_area_mm2": np.broadcast_to(1e6 * lattice(own.body).areas, own.areas.shape),
    }
    places = 1e3 * np.array([rest + field(one) for one in forces])
    direction = _open(own.direction, own.normals, again.normals - again.direction)
    if own.body.relaxation:  # what viscosity remembers is no force of this frame
        friction = again.friction
    else:
        apart = _across(known, again.direction) - again.friction
        friction = _open(own.friction, _across(forces, own.direction), apart)
    for k, axis in enumerate("xyz"):
        values[f"node_{axis}_mm"] = places[..., k]
        values[f"node_direction_{axis}"] = direction[..., k]
        values[f"node_friction_{axis}_n"] = friction[..., k]
    return values


def _open(told: Array, law: Array, apart: Array) -> Array:
    """Clip stored values to those by a law ± twice `apart`, the deviation in the simulation."""
    return np.clip(told, law - 2.0 * abs(apart), law + 2.0 * abs(apart))


def _across(forces: Array, direction: Array) -> Array:
    """Part of the silicone's forces across `direction`: friction, as stiffening acts along it."""
    return np.asarray(forces - direction * (forces * direction).sum(axis=-1, keepdims=True))


def _carried(own: _Dome, loaded: Flags) -> Array:
    """Solve for the forces that displace the loaded nodes as stored [N], shape (T, N, 3).

    They act on the linear silicone and determine the displacement of all other nodes and markers.

    Parameters
    ----------
    loaded: whether each node carries a force, shape (T, N)
    """
    rest, field = lattice(own.body).points, skin_field(own.body)
    forces = np.zeros(own.places.shape)
    # Relative residual to which forces on the silicone are found from its displacement.
    solved = 1e-7
    for k, some in enumerate(map(np.flatnonzero, loaded)):
        if not len(some):
            continue
        moved = (own.places[k] - rest)[some].ravel()
        first = own.normal[k, some, None] * own.direction[k, some] + own.friction[k, some]
        matrix = field.of_nodes(some)[:, :, some].reshape(len(moved), -1).T
        found, _ = scipy.sparse.linalg.cg(
            scipy.sparse.linalg.aslinearoperator(matrix),
            moved,
            first.ravel(),
            rtol=solved,
            maxiter=10 * len(moved),
        )
        forces[k, some] = found.reshape(-1, 3)
    return forces


def wrong_dome(stored: Stored, driven: bool) -> Iterator[str]:
    """Yield messages on frames whose forces or motion violate friction or balance.

    Parameters
    ----------
    driven: whether grip and load move the object; else its pose is prescribed
    """
    own, again, mu = _Dome.told(stored), _Dome.simulated(stored), stored.frames["mu"]
    for k in range(len(own.on)):
        for wrong in _wrong_forces(own, k, float(mu[k])):
            yield f"frame {k}: {wrong}"
        # A node may have slipped between two frames, and stick in both.
        if k and not any(_wrong_way(again, k)):
            for wrong in _wrong_way(own, k):
                yield f"frame {k}: {wrong}"
    if driven:
        yield from _unbalanced(stored)


def _wrong_forces(own: _Dome, k: int, mu: float) -> Iterator[str]:
    """Yield messages on node forces of frame k that violate sign, cone or direction."""
    normal, direction, friction, on = own.normal[k], own.direction[k], own.friction[k], own.on[k]
    # Tolerance of directions and of friction across them, as a share of the sum of all forces, and
    # at least [N].
    slack_share, slack_least = 1e-4, 1e-5
    slack = max(slack_share * float(abs(normal).sum()), slack_least)
    sizes, held = np.linalg.norm(friction, axis=1), mu * normal
    if not (normal >= 0.0).all():
        yield "node_normal_n is negative on a node"
    # Tolerance of a node's share of the friction limit, where it is said to slip or not.
    cone_error = 2e-3
    if not (sizes <= (1.0 + cone_error) * held + slack / 100.0).all():
        yield "node_friction_x_n … on a node is more than µ times its normal force"
    if not (abs(np.linalg.norm(direction[on], axis=1) - 1.0) <= slack_share).all():
        yield "node_direction_x … of a node's normal force is not of length 1"
    if not (abs((direction * friction).sum(axis=1)) <= slack / 10.0).all():
        yield "node_friction_x_n … on a node is not across its normal force"
    share = np.divide(sizes, held, out=np.zeros_like(sizes), where=held > 0.0)
    if (share[own.slips[k]] < SLIPPING - cone_error).any():
        least = share[own.slips[k]].min()
        yield f"node_slips of a node with {least:.3f} of the friction that it holds"
    stick = on & ~own.slips[k]
    if (share[stick] > SLIPPING + cone_error).any():
        most = share[stick].max()
        yield f"node_slips is not set of a node with {most:.3f} of the friction that it holds"


def _wrong_way(own: _Dome, k: int) -> Iterator[str]:
    """Yield messages on nodes whose path over the object since frame k − 1 contradicts friction.

    A sticking node keeps its place on the object, except for the presliding of Dahl friction. On a
    slipping node friction opposes the slip.
    """
    normal, slips, direction = own.normal, own.slips, own.direction[k]
    moved = (own.seen[k] - own.seen[k - 1]) @ own.turns[k].T
    # Nodes whose ways are looked at: growth of the normal force, and its share of the largest.
    growth, firm_share = 1.02, 0.1
    # A node may have slipped between two frames while it was pressed less.
    steady = own.on[k] & own.on[k - 1] & (normal[k] <= growth * normal[k - 1])
    steady &= normal[k] > firm_share * normal[k].max()
    along = moved - direction * (moved * direction).sum(axis=1, keepdims=True)
    way = np.linalg.norm(along, axis=1)
    stick = steady & ~slips[k] & ~slips[k - 1]
    stuck_m = 1e-6  # tolerance of the way of a node that sticks [m]
    turns = 2.0  # it is so much longer than `presliding` where friction turns as it grows
    longest = turns * presliding(own.solids[k], normal[k] / own.areas[k]) + stuck_m
    if (over := (way - longest)[stick]).size and over.max() > 0.0:
        yield f"a node without node_slips moves {1e6 * way[stick][over.argmax()]:.3g} µm"
    slid = steady & slips[k] & slips[k - 1] & (way > longest)
    before, now = own.friction[k - 1], own.friction[k]
    sizes = np.linalg.norm(before, axis=1) * np.linalg.norm(now, axis=1)
    straight = 0.9  # friction turned by less than this since the frame before: cosine
    slid &= (before * now).sum(axis=1) > straight * sizes
    if ((along * now).sum(axis=1)[slid] > 0.0).any():
        yield "friction pulls a node the way it slips"


def presliding(solid: Solid, pressure: Array) -> Array:
    """Longest path of a sticking node over an object [m]: Dahl friction from −µp to 0.98 µp.

    Parameters
    ----------
    pressure: pressure p on the nodes [Pa], (N,)
    """
    n, limit = solid.dahl_exponent, solid.friction * pressure / solid.dahl_stiffness
    if n == 1.0:
        return np.asarray(limit * np.log(2.0 / (1.0 - SLIPPING)))
    return np.asarray(limit * (2.0 ** (1.0 - n) - (1.0 - SLIPPING) ** (1.0 - n)) / (1.0 - n))


def _unbalanced(stored: Stored) -> Iterator[str]:
    """Yield messages on frames in which grip, load, contact and dampers do not balance."""
    column, scene, again = stored.frames, stored.scene, stored.again
    drags = np.array([scene.object.drag_n_s_per_m, PRESS_DRAG])

    def impulses(drive: Array, force: Array, way: Array) -> Array:
        return missing_impulses(drive + force[:, [0, 2]] * [-1.0, 1.0], drags * way, scene.period)

    drive = np.stack([column["load_n"], column["grip_n"]], axis=1)
    told = 1e-3 * np.stack([column["object_mm"], column["rigid_part_mm"]], axis=1)
    ways = [(sample.contact.place[0], sample.contact.indentation) for sample in again]
    forces = [sample.contact.field.total_force for sample in again]
    yield from unbalanced_impulses(
        drive,
        impulses(drive, stored.vectors("force_{}_n"), told),
        impulses(stored.drive, np.array(forces), np.array(ways)),
    )
