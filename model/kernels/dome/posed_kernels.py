"""Contacts of one dome at prescribed poses, and what changes of pose and object do to them."""

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from .krylov_kernels import System, invert_three
from .newton_kernels import nobody, solve_contact
from .node_kernels import Contact, Outcome
from .touch_kernels import Pose, Stiffening, Touched, touch

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.int64]


@njit()
def stiffening_by(
    law: Array, friction: float, areas: Array, forces: Array, tangential: Array
) -> tuple[float, float]:
    """Share and power of a `Stiffening`, from the contact before a step.

    Parameters
    ----------
    law: of the body, see `stiffening.law_of`
    friction: coefficient µ
    areas: of the nodes [m²], shape (n,)
    forces, tangential: on the nodes, and their friction [N], shape (n, 3)
    """
    whole, sideways, area = 0.0, 0.0, 0.0
    for i in range(areas.size):
        along, across = 0.0, 0.0
        for a in range(3):
            along += (forces[i, a] - tangential[i, a]) ** 2
            across += tangential[i, a] ** 2
        whole += np.sqrt(along)
        sideways += np.sqrt(across)
        if along > 0.0:
            area += areas[i]
    if law[0] == 0.0 or whole == 0.0:
        return 0.0, 1.0
    wide = np.sqrt(area / np.pi) / law[0]
    slips = sideways / (friction * whole)
    x, y = wide / law[1], wide / law[5]
    slipping = law[2] * (law[1] * x / np.sqrt(1.0 + x * x)) ** law[3]
    sticking = law[6] * (y / (1.0 + y**4.0) ** 0.25) ** law[7]
    share = slips * slipping + (1.0 - slips) * sticking
    return share, slips * law[4] + (1.0 - slips) * law[8]


@njit()
def solve_posed(
    rest: Array,
    radial: Array,
    areas: Array,
    compliance: Single,
    own: Array,
    law: Array,
    thing: Touched,
    rotations: Array,
    places: Array,
    before: Array,
    forces: Array,
    friction: Array,
    tolerance: float,
    most_rounds: int,
    warm: bool,
    system: System,
    results: Array,
) -> float:
    """One step of a contact; returns the relative change that another round would make.

    Parameters
    ----------
    rest, radial, areas, compliance, own: of the nodes, as in `Contact`
    law: of the body, see `stiffening.law_of`
    rotations, places: of the object before the step and after it, (2, 3, 3) and (2, 3)
    before: displacement before the step [m], (n, 3)
    forces, friction: before the step [N], (n, 3)
    warm: as of `solve_contact`
    results: displacement, linear forces, forces, friction and normals, (5, n, 3); on entry a guess
        of the linear forces
    """
    contact = Contact(
        rest, radial, areas, rest + before, np.zeros(rest.shape), friction, compliance, own
    )
    outcome = Outcome(results[1], results[2], results[3], results[4], results[0], np.zeros(6))
    pose = Pose(rotations[0], places[0], rotations[1], places[1])
    share, power = stiffening_by(law, thing.friction, areas, forces, friction)
    stiff = Stiffening(share, power, law[0])
    # Made here: of another type than those of a step's own caller, they would be another kernel.
    held, inertia, wrench = np.zeros(6, np.bool_), np.zeros((6, 6)), np.zeros(6)
    return solve_contact(
        contact, thing, pose, stiff, 1.0, held, inertia, wrench, tolerance, most_rounds,
        warm, system, outcome, nobody(stiff),
    )[0]  # fmt: skip


@njit()
def posed_forces(
    rest: Array,
    radial: Array,
    areas: Array,
    law: Array,
    shape: Touched,
    numbers: Array,
    materials: Array,
    rotations: Array,
    places: Array,
    before: Array,
    forces: Array,
    friction: Array,
    displacement: Array,
    results: Array,
    slopes: Array,
) -> None:
    """Forces in C contacts whose nodes are at given places.

    Parameters
    ----------
    rest, radial, areas, law: as in `solve_posed`
    shape: an object of the kind that all are
    numbers: of the objects' shapes, (C, 8)
    materials: stiffness, µ, σ0 and Dahl exponent of each, (C, 4)
    rotations, places: of the objects before the step and after it, (C, 2, 3, 3) and (C, 2, 3)
    before: displacement before the step [m], (C, n, 3)
    forces, friction: before the step [N], (C, n, 3)
    displacement: after it [m], (C, n, 3)
    results: linear forces, forces, friction and normals, (4, C, n, 3) (output)
    slopes: derivative of the first contact's linear forces by the nodes' places [N/m], (n, 3, 3)
        (output); (0, 3, 3) where it is not wanted
    """
    cases, n = before.shape[0], before.shape[1]
    now, was, old, slope = np.empty(3), np.empty(3), np.empty(3), np.empty((3, 3))
    stiffened, work = np.empty(2), np.empty(11)
    for c in range(cases):
        thing = Touched(
            shape.kind, numbers[c], shape.grid, shape.origin, shape.cells, materials[c, 0],
            materials[c, 1], materials[c, 2], materials[c, 3],
        )  # fmt: skip
        pose = Pose(rotations[c, 0], places[c, 0], rotations[c, 1], places[c, 1])
        turn = pose.rotation @ pose.old_rotation.T
        share, power = stiffening_by(law, materials[c, 1], areas, forces[c], friction[c])
        stiff = Stiffening(share, power, law[0])
        tangent = c == 0 and len(slopes) > 0
        for i in range(n):
            inwards = 0.0
            for a in range(3):
                now[a] = rest[i, a] + displacement[c, i, a]
                was[a] = rest[i, a] + before[c, i, a]
                inwards -= displacement[c, i, a] * radial[i, a]
                old[a] = 0.0
                for b in range(3):
                    old[a] += turn[a, b] * friction[c, i, b]
            linear, true, normal = results[0, c, i], results[1, c, i], results[3, c, i]
            touches = touch(
                thing, pose, stiff, areas[i], was, now, inwards, radial[i], old, False, False,
                tangent, normal, work, linear, true, slope, stiffened,
            )  # fmt: skip
            along = 0.0
            for a in range(3):
                if not touches:
                    normal[a] = 0.0
                along += true[a] * normal[a]
            for a in range(3):
                results[2, c, i, a] = true[a] - along * normal[a]
            if tangent:
                slopes[i] = slope


@njit()
def linear_system(
    compliance: Single, own: Array, active: Index, slopes: Array, changes: Array, matrix: Single
) -> None:
    """Equations for changes of the linear forces on active nodes; their own motion is eliminated.

    A force f = Φ(u) and u = A·f give δf − T·A·δf = r for a change r of Φ, T its slope. Here each
    node's own 3 × 3 of A is taken to the left first, so that stiff objects leave them well scaled.

    Parameters
    ----------
    compliance, own: as in `Contact`
    active: nodes, (k,)
    slopes: T of all nodes [N/m], (n, 3, 3)
    changes: r of all nodes, (C, n, 3); those of active ones are changed as the matrix is
    matrix: (3k, 3k) (output)
    """
    k = len(active)
    left, inverse = np.empty((3, 3)), np.empty((3, 3))
    answer, right = np.empty((3, 3), np.float32), np.empty(3)
    for p in range(k):
        i = active[p]
        for a in range(3):
            for b in range(3):
                left[a, b] = 1.0 if a == b else 0.0
                for d in range(3):
                    left[a, b] -= slopes[i, a, d] * own[i, d, b]
        if not invert_three(left, inverse):
            inverse[:] = 0.0
        for a in range(3):
            for b in range(3):
                total = 0.0
                for d in range(3):
                    total += inverse[a, d] * slopes[i, d, b]
                answer[a, b] = total
        for c in range(len(changes)):
            for a in range(3):
                right[a] = 0.0
                for b in range(3):
                    right[a] += inverse[a, b] * changes[c, i, b]
            for a in range(3):
                changes[c, i, a] = right[a]
        x, y, z = compliance[3 * i], compliance[3 * i + 1], compliance[3 * i + 2]
        for a in range(3):
            row = matrix[3 * p + a]
            for q in range(k):
                for b in range(3):
                    j = 3 * active[q] + b
                    row[3 * q + b] = -(
                        answer[a, 0] * x[j] + answer[a, 1] * y[j] + answer[a, 2] * z[j]
                    )
            for b in range(3):
                row[3 * p + b] = 1.0 if a == b else 0.0
