"""Physical laws that the labels of a chain must obey: depth, friction, balance of forces, cones."""

from collections.abc import Iterator
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ...model import Fingertip, ForceField, chain_forces
from ...model.chain import chain, contact
from ...model.kernels import contact_frames, dahl_path, frictions_at
from ...render import harmonic_map
from ...sensing.contact import of_chain
from .columns import columns_of
from .laws import Array, Stored, Table, lawful_frames, lawful_markers
from .shot import SLIPPING

#: Node whose force, or share of µ·Fn, is so near to a threshold may lie on either side of it.
_NEAR = 1e-4


class _Chain:
    """Positions and forces of a chain's N nodes in the T frames of a sequence, in SI units.

    Parameters
    ----------
    stored: labels and scene of the sequence
    seen: displacements of the nodes relative to the rigid part, shape (T, N, 2)
    rigid, moved: displacement of the rigid part along z and of the object along x, shape (T,)
    normal, friction: normal and friction force on each node, shape (T, N)

    Attributes
    ----------
    ground: positions of the nodes in the ground frame, shape (T, N, 2)
    normals, tangents: unit vectors of the object's surface at each node, shape (T, N, 2)
    depth: normal force that follows from the penetration of each node, shape (T, N)
    held: largest friction force µ·Fn that each node can hold, shape (T, N)
    """

    def __init__(
        self, stored: Stored, seen: Array, rigid: Array, moved: Array, normal: Array,
        friction: Array,
    ) -> None:  # fmt: skip
        self.tip: Fingertip = stored.scene.build_fingertip()
        self.chain = chain(self.tip)
        self.seen, self.rigid, self.moved = seen, rigid, moved
        self.normal, self.friction = normal, friction
        self.ground = self.tip.rest_positions() + seen
        self.ground[..., 1] += rigid[:, None]
        self.objects = [of_chain(sample.contact)[0] for sample in stored.again]
        self.contacts = [contact(self.tip, obj) for obj in self.objects]
        self.depth, self.held = np.empty(normal.shape), np.empty(normal.shape)
        self.normals = np.empty(seen.shape)
        for k, ct in enumerate(self.contacts):
            gap, self.normals[k] = contact_frames(ct, self.ground[k], moved[k])
            self.depth[k] = ct.stiffness * self.chain.share * np.maximum(0.0, -gap)
            self.held[k] = frictions_at(ct, self.ground[k, :, 0] - moved[k]) * normal[k]
        self.tangents = np.stack([-self.normals[..., 1], self.normals[..., 0]], axis=-1)

    @classmethod
    def told(cls, stored: Stored) -> Self:
        """Read positions and forces from the labels of the dataset."""
        column = {name: stored.markers[name].astype(float) for name in columns_of("chain").nodes}
        places = 1e-3 * np.stack([column["node_x_mm"], column["node_z_mm"]], axis=-1)
        return cls(
            stored,
            places - stored.scene.build_fingertip().rest_positions(),
            1e-3 * stored.frames["rigid_part_mm"],
            1e-3 * stored.frames["object_mm"],
            column["node_normal_n"],
            column["node_friction_n"],
        )

    @classmethod
    def simulated(cls, stored: Stored) -> Self:
        """Take positions and forces from the scene simulated again.

        Their deviations from the laws, due to the time between frames, set the tolerances.
        """
        states = [of_chain(sample.contact)[1].deformation for sample in stored.again]
        fields = [sample.contact.field for sample in stored.again]
        return cls(
            stored,
            np.array([state.seen for state in states]),
            np.array([state.rigid_part for state in states]),
            np.array([state.object_position for state in states]),
            np.array([field.normal for field in fields]),
            np.array([field.friction for field in fields]),
        )


def lawful_chain(stored: Stored) -> tuple[Table, Table]:
    """Compute the values that the laws demand of the columns of frames and of markers."""
    own, scene, on = _Chain.told(stored), stored.scene, stored.markers["node_contact"]
    fields = [
        ForceField(
            position=own.ground[k],
            normal=own.normal[k],
            friction=own.friction[k],
            contact=on[k],
            totals_covariance=np.zeros((2, 2)),
        )
        for k in range(len(on))
    ]
    design = scene.build_sensor()
    carry = harmonic_map(design.shape, design.places, own.tip.nodes).scalar
    forces = np.where(on, [own.normal, own.friction], 0.0)
    at_markers = np.stack([carry(frame.T).T for frame in forces.transpose(1, 0, 2)], axis=1)
    threshold = own.tip.contact_threshold
    either = abs(own.depth - threshold) < _NEAR * threshold
    markers = lawful_markers(stored, own.tip.nodes, list(own.seen))
    markers |= {
        "normal_n": np.tile(at_markers[0], 2),
        "friction_n": np.tile(at_markers[1], 2),
        "node_contact": np.where(either, on, own.depth > threshold),
        "node_normal_n": own.depth,
        "node_x_mm": stored.markers["node_x_mm"],  # held by the balance of forces
        "node_z_mm": stored.markers["node_z_mm"],
        "node_friction_n": _friction(own, _Chain.simulated(stored)),
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
        held, normal = (np.where(on, of, 0.0).sum(axis=1) for of in (own.held, own.normal))
        frames["mu"] = held / normal
    return frames, markers


def _slips(own: _Chain, stored: Stored) -> NDArray[np.bool_]:
    """Determine the nodes that slip; near the threshold, `slipped_share` decides."""
    on, held = stored.markers["node_contact"], SLIPPING * stored.markers["node_mu"] * own.normal
    slips = on & (abs(own.friction) >= (1.0 + _NEAR) * held)
    either = on & (abs(own.friction) >= (1.0 - _NEAR) * held) & ~slips
    told = np.rint(stored.frames["slipped_share"] * on.sum(axis=1)) - slips.sum(axis=1)
    for k, more in enumerate(map(np.flatnonzero, either)):
        slips[k, more[: int(min(max(told[k], 0), len(more)))]] = True
    return slips


def _friction(own: _Chain, again: _Chain) -> Array:
    """Friction by the Dahl law from the previous frame; the stored value where it is open."""
    law = _dahl(own)
    open_to = 2.0 * abs(_dahl(again) - again.friction)
    # A node that came into contact since then began somewhere within the interval.
    new = np.insert((own.normal[:-1] <= 0.0) | (own.normal[1:] <= 0.0), 0, False, axis=0)
    return np.where(new, own.friction, np.clip(own.friction, law - open_to, law + open_to))


def _dahl(own: _Chain) -> Array:
    """Friction by the Dahl law, for the path of the object over each node since the previous frame.

    The path is assumed to be straight, and the normal force to change linearly along it.
    """
    law = np.zeros(own.friction.shape)
    for k in range(1, len(law)):
        moved = own.ground[k - 1] - own.ground[k]
        moved[:, 0] += own.moved[k] - own.moved[k - 1]
        way, ct = (moved * own.tangents[k]).sum(axis=1), own.contacts[k]
        bristle = ct.bristle * own.chain.share
        for i in np.flatnonzero((own.normal[k - 1] > 0.0) & (own.normal[k] > 0.0)):
            law[k, i], _ = dahl_path(
                own.friction[k - 1, i], way[i], own.normal[k - 1, i], own.normal[k, i],
                own.held[k, i] / own.normal[k, i], bristle[i], ct.exponent,
            )  # fmt: skip
    return law


def wrong_chain(stored: Stored) -> Iterator[str]:
    """Yield messages on frames with friction outside its cone or forces out of balance."""
    own, again = _Chain.told(stored), _Chain.simulated(stored)
    # Tolerance of friction cones, as a share of the largest force, and at least [N].
    share, least = 1e-4, 1e-5
    slack = np.maximum(share * abs(own.normal).max(axis=1, initial=0.0), least)[:, None]
    for k, i in np.argwhere(~(own.normal >= 0.0))[:1]:
        yield f"frame {k}: node_normal_n[{i}] is {own.normal[k, i]:.3g}, which is negative"
    held = np.maximum(stored.markers["node_mu"] * own.normal, own.held)
    for k, i in np.argwhere(~(abs(own.friction) <= held + slack))[:1]:
        yield (
            f"frame {k}: node_friction_n[{i}] is {own.friction[k, i]:.3g}, more than µ times its "
            "normal force"
        )
    yield from _unbalanced_nodes(own, again)
    drive = np.stack([stored.frames["load_n"], stored.frames["grip_n"]], axis=1)
    period = stored.scene.period
    yield from unbalanced_impulses(
        drive, _impulses(own, drive, period), _impulses(again, stored.drive, period)
    )


def _unbalanced_nodes(own: _Chain, again: _Chain) -> Iterator[str]:
    """Yield nodes on which springs and contact do not balance; nodes have no inertia.

    A dataset has no speeds, so that damper forces are unknown. Those of the simulation are the
    tolerance.
    """
    ch = own.chain
    stiff = ch.tissue.copy()
    stiff[:-1] += ch.membrane
    stiff[1:] += ch.membrane
    # Tolerance of the balance of forces on a node: of the largest force on one, and rounding of
    # places [m].
    share, rounded_m = 0.01, 4e-9
    slack = share * np.hypot(own.normal, own.friction).max(axis=1, keepdims=True)
    off = _off(own, stiff)
    for k, i in np.argwhere(~(off <= slack + rounded_m * stiff + 2.0 * _off(again, stiff)))[:1]:
        yield (
            f"frame {k}: node_x_mm[{i}], node_z_mm[{i}]: springs do not balance node_normal_n and "
            f"node_friction_n there, by {off[k, i]:.2g} N"
        )


def _off(own: _Chain, stiff: Array) -> Array:
    """Force on each node that springs and contact do not balance [N], shape (T, N)."""
    springs = np.stack([chain_forces(own.tip, seen) for seen in own.seen])
    applied = own.normal[..., None] * own.normals + own.friction[..., None] * own.tangents
    off = np.linalg.norm(applied - springs, axis=-1)
    # The outer nodes are where they rest; forces on them go into the rigid part.
    ends = [0, -1]
    off[:, ends] = np.linalg.norm(own.seen[:, ends], axis=-1) * stiff[ends]
    return off


def _impulses(own: _Chain, drive: Array, period: float) -> Array:
    """Unbalanced mean forces along x and z, see `missing_impulses` [N], shape (T − 1, 2).

    Grip, load, contact and dampers to ground act on fingertip and object; there is no inertia. The
    normals of the object resolve contact forces along x and z. An object with `surface = "stays"`
    receives friction only.
    """
    travel = np.array([ct.travel for ct in own.contacts])
    pressed = (own.normal[..., None] * own.normals).sum(axis=1)
    rubbed = (own.friction[..., None] * own.tangents).sum(axis=1)
    x = drive[:, 0] - travel * pressed[:, 0] - rubbed[:, 0]
    z = drive[:, 1] + pressed[:, 1] + rubbed[:, 1]
    # The outer nodes are held by the rigid part.
    inner = own.ground[:, 1:-1, 1] - own.tip.rest_positions()[1:-1, 1]
    drag = np.array([obj.drag for obj in own.objects])
    ground = inner @ own.chain.damping[1:-1] + own.chain.damping_rigid * own.rigid
    return missing_impulses(
        np.stack([x, z], axis=1), np.stack([drag * own.moved, ground], axis=1), period
    )


def missing_impulses(on: Array, at: Array, period: float) -> Array:
    """Mean force in each interval between frames that dampers do not balance [N], (T − 1, 2).

    The mean force of a damper follows from the motion between two frames, so that impulses over
    each interval are compared.

    Parameters
    ----------
    on: forces along x and z except those of dampers [N], shape (T, 2)
    at: impulse of the dampers since the start [N·s], shape (T, 2)
    period: time between frames [s]
    """
    return np.asarray(np.diff(at, axis=0) / period - (on[1:] + on[:-1]) / 2)


def unbalanced_impulses(drive: Array, own: Array, again: Array) -> Iterator[str]:
    """Yield a message on the first interval between frames in which forces do not balance.

    Parameters
    ----------
    drive: load and grip of each frame [N], shape (T, 2)
    own, again: result of `missing_impulses` for the stored labels, and for the scene simulated
        again [N], shape (T − 1, 2)
    """
    balance = 0.05  # tolerance of the balance of forces, as a share of the largest grip or load
    slack = balance * abs(drive).max()
    for k, axis in np.argwhere(~(abs(own - again) <= slack))[:1]:
        names = ("load_n, node_friction_n, object_mm", "grip_n, node_normal_n, rigid_part_mm")
        yield (
            f"frame {k + 1}: forces along {'xz'[axis]} do not balance since the frame before: "
            f"{names[axis]}"
        )
