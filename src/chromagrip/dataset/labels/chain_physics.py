"""Laws of the labels of the node model: depth, friction, balance of forces, cones."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...loop.world import Clock
from ...model import Fingertip, ForceField
from ...model.chain import chain, contact
from ...model.chain.stiffness import chain_forces
from ...model.kernels import contact_frames
from ...model.kernels.contact import frictions_at
from ...model.kernels.friction import dahl_path
from ...render import harmonic_map
from ...sensing.contact import of_chain
from .columns import columns_of
from .laws import Array, Stored, Table, lawful_frames, lawful_markers
from .shot import SLIPPING

#: Tolerance of the balance of forces, as a share of the largest grip or load.
_BALANCE = 0.05
#: Tolerance of friction cones, as a share of the largest force, and at least [N].
_SHARE, _LEAST = 1e-4, 1e-5
#: Node whose force, or share of µ·Fn, is so near to a threshold may lie on either side of it.
_NEAR = 1e-4
#: Tolerance of the balance of forces on a node: of the largest force on one, of the force of
#: dampers had all the way since the frame before been in the last step, and rounding of places [m].
_NODE, _DAMPED, _ROUNDED = 0.01, 2.0, 4e-9


class _Chain:
    """Places and forces of a sequence's nodes, in SI units.

    Attributes
    ----------
    seen: displacement of the nodes relative to the rigid part, shape (T, N, 2)
    ground: places of the nodes in the ground frame, shape (T, N, 2)
    normals, tangents: of the object at each node, shape (T, N, 2)
    depth: normal force that the gap of each node makes, shape (T, N)
    normal, friction, mu: columns, shape (T, N)
    held: friction that each node holds in the last step before a frame, shape (T, N)
    rigid, moved: of the rigid part along z and of the object along x, shape (T,)
    """

    def __init__(self, stored: Stored) -> None:
        scene, markers = stored.scene, stored.markers
        column = {name: markers[name].astype(float) for name in columns_of("chain").nodes}
        self.tip: Fingertip = scene.build_fingertip()
        self.chain, rest = chain(self.tip), self.tip.rest_positions()
        places = 1e-3 * np.stack([column["node_x_mm"], column["node_z_mm"]], axis=-1)
        self.rigid = 1e-3 * stored.frames["rigid_part_mm"]
        self.moved = 1e-3 * stored.frames["object_mm"]
        self.seen, self.ground = places - rest, places.copy()
        self.ground[..., 1] += self.rigid[:, None]
        self.normal, self.friction = column["node_normal_n"], column["node_friction_n"]
        self.mu, self.on = column["node_mu"], markers["node_contact"].astype(bool)
        self.objects = [of_chain(sample.contact)[0] for sample in stored.again]
        self.contacts = [contact(self.tip, obj) for obj in self.objects]
        self.depth, self.normals = np.empty(self.normal.shape), np.empty(places.shape)
        self.held = np.empty(self.normal.shape)
        for k, ct in enumerate(self.contacts):
            mu = frictions_at(ct, self.ground[k, :, 0] - self.moved[k])
            self.held[k] = mu * self.normal[k]
            gap, self.normals[k] = contact_frames(ct, self.ground[k], self.moved[k])
            self.depth[k] = ct.stiffness * self.chain.share * np.maximum(0.0, -gap)
        self.tangents = np.stack([-self.normals[..., 1], self.normals[..., 0]], axis=-1)


def lawful_chain(stored: Stored) -> tuple[Table, Table]:
    """Values of the columns of frames and markers that follow from others and from the scene."""
    own, scene = _Chain(stored), stored.scene
    fields = [
        ForceField(
            position=own.ground[k],
            normal=own.normal[k],
            friction=own.friction[k],
            contact=own.on[k],
            totals_covariance=np.zeros((2, 2)),
        )
        for k in range(len(own.on))
    ]
    design = scene.build_sensor()
    carry = harmonic_map(design.shape, design.places, own.tip.nodes).scalar
    forces = np.where(own.on, [own.normal, own.friction], 0.0)
    at_markers = np.stack([carry(frame.T).T for frame in forces.transpose(1, 0, 2)], axis=1)
    threshold = own.tip.contact_threshold
    either = abs(own.depth - threshold) < _NEAR * threshold
    markers = lawful_markers(stored, own.tip.nodes, list(own.seen))
    markers |= {
        "normal_n": np.tile(at_markers[0], 2),
        "friction_n": np.tile(at_markers[1], 2),
        "node_contact": np.where(either, own.on, own.depth > threshold),
        "node_normal_n": own.depth,
        "node_x_mm": stored.markers["node_x_mm"],  # held by the balance of forces
        "node_z_mm": stored.markers["node_z_mm"],
        "node_friction_n": _friction(own),
        "node_mu": np.stack(
            [
                frictions_at(
                    contact(own.tip, scene.build_object(time)), own.ground[k, :, 0] - own.moved[k]
                )
                for k, time in enumerate(stored.times)
            ]
        ),
    }
    frames = lawful_frames(stored, fields, _slips(own, stored))
    if scene.object.friction_factors:
        held, normal = (np.where(own.on, of, 0.0).sum(axis=1) for of in (own.held, own.normal))
        frames["mu"] = held / normal
    return frames, markers


def _slips(own: _Chain, stored: Stored) -> NDArray[np.bool_]:
    """Nodes that slip; those near the threshold as the frame's share says."""
    held = SLIPPING * own.mu * own.normal
    sure = own.on & (abs(own.friction) >= (1.0 + _NEAR) * held)
    maybe = own.on & (abs(own.friction) >= (1.0 - _NEAR) * held)
    told = np.rint(stored.frames["slipped_share"] * own.on.sum(axis=1))
    slips = sure.copy()
    for k in range(len(sure)):
        more = np.flatnonzero(maybe[k] & ~sure[k])
        wanted = told[k] - sure[k].sum()
        slips[k, more[: int(min(max(wanted, 0), len(more)))]] = True
    return slips


def _friction(own: _Chain) -> Array:
    """Friction by the Dahl law, along the way of the object over each node since the frame before.

    A node that came into contact since then began somewhere within it: the law says nothing of it.
    Where way, normal force or µ change, what they were in between makes a difference: the friction
    may differ by that much.
    """
    law, before = own.friction.copy(), np.zeros(own.friction.shape[1])
    law[0] = 0.0
    for k in range(1, len(law)):
        moved = own.ground[k - 1] - own.ground[k]
        moved[:, 0] += own.moved[k] - own.moved[k - 1]
        way, ct = (moved * own.tangents[k]).sum(axis=1), own.contacts[k]
        bristle = ct.bristle * own.chain.share
        changed = bristle * abs(way - before)
        changed += abs(own.held[k] - own.held[k - 1])
        before = way
        for i in np.flatnonzero((own.normal[k - 1] > 0.0) & (own.normal[k] > 0.0)):
            end, _ = dahl_path(
                own.friction[k - 1, i], way[i], own.normal[k - 1, i], own.normal[k, i],
                own.held[k, i] / own.normal[k, i], bristle[i], ct.exponent,
            )  # fmt: skip
            law[k, i] = min(max(own.friction[k, i], end - changed[i]), end + changed[i])
    return law


def wrong_chain(stored: Stored) -> Iterator[str]:
    """Yield frames with forces beyond friction, or out of balance."""
    own = _Chain(stored)
    slack = np.maximum(_SHARE * abs(own.normal).max(axis=1, initial=0.0), _LEAST)[:, None]
    for k, i in np.argwhere(~(own.normal >= 0.0))[:1]:
        yield f"frame {k}: node_normal_n[{i}] is {own.normal[k, i]:.3g}, which is negative"
    over = ~(abs(own.friction) <= np.maximum(own.mu * own.normal, own.held) + slack)
    for k, i in np.argwhere(over)[:1]:
        yield (
            f"frame {k}: node_friction_n[{i}] is {own.friction[k, i]:.3g}, more than µ times its "
            "normal force"
        )
    yield from _unbalanced_nodes(own, Clock.of_scene(stored.scene).step)
    yield from _unbalanced(own, stored)


def _unbalanced_nodes(own: _Chain, step: float) -> Iterator[str]:
    """Yield nodes on which springs, contact and damper do not balance; there is no inertia.

    The outer nodes are held by the rigid part. The force of a damper follows from the speed in the
    last step, of which the way since the frame before is a bound.
    """
    ch = own.chain
    springs = np.stack([chain_forces(own.tip, seen) for seen in own.seen])
    applied = own.normal[..., None] * own.normals + own.friction[..., None] * own.tangents
    way = np.linalg.norm(np.diff(own.ground, axis=0), axis=-1).max(axis=1)
    speed = np.insert(way, 0, 0.0) / step
    stiff = ch.tissue.copy()
    stiff[:-1] += ch.membrane
    stiff[1:] += ch.membrane
    slack = _NODE * np.linalg.norm(applied, axis=-1).max(axis=1, keepdims=True)
    slack = slack + _DAMPED * speed[:, None] * ch.damping + _ROUNDED * stiff
    off = np.linalg.norm(applied - springs, axis=-1)
    # The outer nodes are where they rest; forces on them go into the rigid part.
    off[:, [0, -1]] = np.linalg.norm(own.seen[:, [0, -1]], axis=-1) * stiff[[0, -1]]
    for k, i in np.argwhere(~(off <= slack))[:1]:
        yield (
            f"frame {k}: node_x_mm[{i}], node_z_mm[{i}]: springs do not balance node_normal_n and "
            f"node_friction_n there, by {off[k, i]:.2g} N"
        )


def _unbalanced(own: _Chain, stored: Stored) -> Iterator[str]:
    """Yield frames in which forces on the fingertip or the object do not balance.

    Grip, load, contact and dampers to ground act on them; there is no inertia. The force of a
    damper follows from the motion between two frames, so that impulses over each interval are
    compared. The object's shape turns contact forces into x and z; of a surface that stays the
    object feels friction alone.
    """
    scene, grip, load = stored.scene, stored.frames["grip_n"], stored.frames["load_n"]
    if scene.frames < 3:
        return
    travel = np.array([ct.travel for ct in own.contacts])
    pressed = (own.normal[..., None] * own.normals).sum(axis=1)
    rubbed = (own.friction[..., None] * own.tangents).sum(axis=1)
    on = np.stack(
        [load - travel * pressed[:, 0] - rubbed[:, 0], grip + pressed[:, 1] + rubbed[:, 1]], axis=1
    )
    # The outer nodes are held by the rigid part.
    inner = own.ground[:, 1:-1, 1] - own.tip.rest_positions()[1:-1, 1]
    drag = np.array([obj.drag for obj in own.objects])
    at = np.stack(
        [drag * own.moved, inner @ own.chain.damping[1:-1] + own.chain.damping_rigid * own.rigid],
        axis=1,
    )
    yield from unbalanced_impulses(stored, on, at)


def unbalanced_impulses(stored: Stored, on: Array, at: Array) -> Iterator[str]:
    """Yield frames over whose interval before them the forces are not those of the dampers.

    Parameters
    ----------
    on: forces along x and z but for dampers [N], shape (T, 2)
    at: impulse of the dampers since the start [N·s], shape (T, 2)
    """
    frames = stored.frames
    slack = _BALANCE * max(*frames["grip_n"], *np.abs(frames["load_n"]))
    off = abs(np.diff(at, axis=0) / stored.scene.period - (on[1:] + on[:-1]) / 2)
    # Friction that changes with µ does so somewhere within the interval.
    off[:, 0] -= abs(np.diff(np.nan_to_num(frames["mu"]))) * frames["normal_n"][1:]
    # The mean of both ends is off by a twelfth of the second difference.
    bend = np.pad(abs(np.diff(on, 2, axis=0)), ((1, 1), (0, 0)), mode="edge")
    off -= np.maximum(bend[1:], bend[:-1]) / 12.0
    # The first interval is left out: the fingertip touches down somewhere within it.
    for k, axis in np.argwhere(~(off[1:] <= slack))[:1]:
        name = ("load_n, friction_n and object_mm", "grip_n, normal_n and rigid_part_mm")[axis]
        yield (
            f"frame {k + 2}: forces along {'xz'[axis]} do not balance since the frame before "
            f"({name})"
        )
