"""The chain's elasticity in the contact solver of the dome: one body, solved by two engines.

`equilibrium` steps chain and object together; the dome's Newton knows of a body only what its
compliance says. Both are given the same grasp, so that each tells of mistakes of the other.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from chromagrip.model import (
    ContactObject,
    ConvergenceError,
    Fingertip,
    chain_compliance,
    chain_forces,
)
from chromagrip.model.chain import chain, contact
from chromagrip.model.kernels.dome import (
    krylov_kernels,
    newton_kernels,
    node_kernels,
    touch_kernels,
)
from chromagrip.model.shapes import cylinder, plane

Array = NDArray[np.float64]

#: Slope over which the jump of the springs' derivative is smoothed in the tangent. Forces are
#: exact all the same: the tangent only says where to look next.
BLUNT = 0.02
#: The springs are turned anew until no node moves by more than this [m], at most so many times; by
#: then none may move by more than ENOUGH, at which some nodes hop over the jump for ever.
STILL, TURNS, ENOUGH = 1e-9, 12, 2e-7
#: Relative change of the forces at which a contact is solved, and the most rounds it may take.
TOLERANCE, ROUNDS = 5e-6, 60
#: Stiffness that holds the object in its place while nothing touches it [N/m].
_HOLD = 1e-4
#: The object starts this deep in the fingertip, which at a gap of 0 would not push back [m].
_DIP = 1e-6
#: A chain's axes x and z among those of a place.
_PLANE = [0, 2]


class Grasped(NamedTuple):
    """Chain and object after a step.

    Attributes
    ----------
    seen: displacements of the nodes relative to the rigid part, with y [m], shape (N, 3)
    forces: of the object on the nodes [N], shape (N, 3)
    friction: their part along the object's tangent [N], shape (N, 3)
    normals: of the object at the nodes, shape (N, 3)
    place: of the object's origin relative to the rigid part [m], shape (3,)
    """

    seen: Array
    forces: Array
    friction: Array
    normals: Array
    place: Array

    @property
    def normal_forces(self) -> Array:
        """Normal force of each node [N], shape (N,)."""
        return np.einsum("ij,ij->i", self.forces, self.normals)

    @property
    def tangential_forces(self) -> Array:
        """Friction of each node along the object's tangent as the chain has it [N], shape (N,)."""
        x, z = self.normals[:, 0], self.normals[:, 2]
        return self.friction[:, 2] * x - self.friction[:, 0] * z


def grasp_by_newton(
    fingertip: Fingertip, obj: ContactObject, grip: float, load: float, parts: int
) -> Grasped:
    """As `equilibrium`, by the dome's contact solver.

    Parameters
    ----------
    fingertip, obj: the chain and its object, flat or round
    grip: force between object and rigid part along z [N]
    load: force on the object along x, raised after the grip [N]
    parts: equal parts in which each of them is raised

    Raises
    ------
    ConvergenceError: where a part has no solution; so it is where the springs buckle
    """
    count = fingertip.nodes
    radius = 1.0 / obj.curvature if obj.curvature else 0.0
    shape = cylinder(radius) if radius else plane()
    thing = touch_kernels.Touched(
        shape.kind, shape.numbers, shape.grid, shape.origin, shape.cells, obj.stiffness,
        obj.friction, obj.dahl_stiffness, obj.dahl_exponent,
    )  # fmt: skip
    zero = np.zeros((count, 3))
    lift = contact(fingertip, obj).lift
    now = Grasped(zero, zero, zero, zero, np.array([0.0, 0.0, lift + radius - _DIP]))
    system = krylov_kernels.new_system(count)
    for stage in range(2 if load else 1):
        for k in range(1, parts + 1):
            share = k / parts
            pull, press = (load * share, grip) if stage else (0.0, grip * share)
            wrench = np.array([pull, 0.0, -press, 0.0, 0.0, 0.0])
            now = _part(fingertip, thing, now, wrench, system)
    return now


def _part(
    fingertip: Fingertip,
    thing: touch_kernels.Touched,
    before: Grasped,
    wrench: Array,
    system: krylov_kernels.System,
) -> Grasped:
    """State under a wrench on the object, from the one before it."""
    now = before
    for _ in range(TURNS):
        after, error = _solved(fingertip, thing, before, now, wrench, system)
        moved = float(abs(after.seen - now.seen).max())
        now = after
        if not np.isfinite(moved):
            break
        if moved < STILL and error <= 10.0 * TOLERANCE:
            return now
    if moved < ENOUGH:
        return now
    raise ConvergenceError(
        f"the chain does not come to rest with the dome's solver under a grip of {-wrench[2]:g} N "
        f"and a load of {wrench[0]:g} N"
    )


def _solved(
    fingertip: Fingertip,
    thing: touch_kernels.Touched,
    before: Grasped,
    guess: Grasped,
    wrench: Array,
    system: krylov_kernels.System,
) -> tuple[Grasped, float]:
    """Solution with the springs linearised at a guess, and the change of its last round."""
    ch = chain(fingertip)
    count = fingertip.nodes
    rest, radial = np.zeros((count, 3)), np.zeros((count, 3))
    rest[:, _PLANE], radial[:, 2] = ch.rest, 1.0
    compliance, offset = _linearised(fingertip, guess.seen)
    zero = np.zeros((count, 3))
    each = np.arange(count)
    own = np.ascontiguousarray(compliance.reshape(count, 3, count, 3)[each, :, each], np.float64)
    near = node_kernels.Contact(
        rest, radial, ch.share.copy(), rest + before.seen, offset, before.friction, compliance, own
    )
    system.gathered[0] = -1  # the compliance is another one
    out = node_kernels.Outcome(
        guess.forces.copy(), zero.copy(), zero.copy(), zero.copy(), zero.copy(), np.zeros(6)
    )
    turn = np.eye(3)
    free = np.array([True, False, True, False, False, False])
    stiff = touch_kernels.Stiffening(0.0, 1.0, 1.0)
    error, *_ = newton_kernels.solve_contact(
        near, thing, touch_kernels.Pose(turn, before.place, turn, guess.place.copy()),
        stiff, 1.0, free, np.diag(_HOLD * free), wrench,
        TOLERANCE, ROUNDS, False, system, out,
        newton_kernels.nobody(stiff),
    )  # fmt: skip
    place = guess.place + out.motion[:3]
    return Grasped(out.displacement, out.true, out.tangential, out.normal, place), float(error)


def _linearised(fingertip: Fingertip, seen: Array) -> tuple[NDArray[np.float32], Array]:
    """Compliance C at a displacement, and b with C·F(seen) + b = seen, in three dimensions.

    Single precision costs nothing: b is of the same C, so that forces and displacements of a
    solution that stays where it was linearised agree to the last digit.
    """
    count = fingertip.nodes
    plane_seen = np.ascontiguousarray(seen[:, _PLANE])
    units = np.eye(2 * count).reshape(count, 2, 2 * count)
    flat = chain_compliance(fingertip, plane_seen, units, BLUNT).reshape(2 * count, 2 * count)
    forces = chain_forces(fingertip, plane_seen)
    forces[[0, -1]] = 0.0  # held by the rigid part
    flat = flat.astype(np.float32)
    offset = np.zeros((count, 3))
    offset[:, _PLANE] = plane_seen - (flat.astype(float) @ forces.ravel()).reshape(count, 2)
    where = (3 * np.arange(count)[:, None] + _PLANE).ravel()
    compliance = np.zeros((3 * count, 3 * count), np.float32)
    # The split law is not symmetric, and the solver goes along rows where it means columns. Each
    # node's own block, which it does not, only says how its Newton steps.
    compliance[np.ix_(where, where)] = flat.T
    return compliance, offset


def unstable_modes(fingertip: Fingertip, seen: Array) -> int:
    """Number of ways in which the chain's springs push themselves further: it buckles.

    Parameters
    ----------
    seen: displacements of the nodes (x, z) relative to the rigid part [m], shape (N, 2)
    """
    count = fingertip.nodes
    units = np.eye(2 * count).reshape(count, 2, 2 * count)
    compliance = chain_compliance(fingertip, seen, units).reshape(2 * count, 2 * count)
    return int((np.linalg.eigvals(compliance[2:-2, 2:-2]).real < 0.0).sum())
