"""Contacts of one dome under several poses and objects at once, from a history of each."""

import numpy as np
from numpy.typing import NDArray

from ....compiled import njit
from .krylov_kernels import System
from .newton_kernels import solve_contact
from .node_kernels import Contact, Outcome
from .touch_kernels import Pose, Stiffening, Touched

Array = NDArray[np.float64]
Single = NDArray[np.float32]

#: No axis of a pose is free, and so none has inertia.
_HELD, _NO_INERTIA, _NO_WRENCH = np.zeros(6, np.bool_), np.zeros((6, 6)), np.zeros(6)


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
def solve_cases(
    rest: Array,
    radial: Array,
    areas: Array,
    compliance: Single,
    own: Array,
    law: Array,
    shape: Touched,
    numbers: Array,
    materials: Array,
    rotations: Array,
    places: Array,
    before: Array,
    forces: Array,
    friction: Array,
    tolerances: Array,
    most_rounds: int,
    system: System,
    results: Array,
    errors: Array,
) -> None:
    """One step of C contacts, all of which are near the first and start from what that changes.

    Parameters
    ----------
    rest, radial, areas, compliance, own: of the nodes, as in `Contact`
    law: of the body, see `stiffening.law_of`
    shape: an object of the kind that all are
    numbers: of the objects' shapes, (C, 8)
    materials: stiffness, µ, σ0 and Dahl exponent of each, (C, 4)
    rotations, places: of the objects before the step and after it, (C, 2, 3, 3) and (C, 2, 3)
    before: displacement before the step [m], (C, n, 3)
    forces, friction: before the step [N], (C, n, 3)
    tolerances: of the first, and of the others
    results: displacement, linear forces, forces, friction and normals, (5, C, n, 3); on entry the
        linear forces before the step
    errors: relative change that another round would make in each, (C,) (output)
    """
    cases, n = before.shape[0], before.shape[1]
    offset, started = np.zeros((n, 3)), results[1, 0].copy()
    at = np.empty((n, 3))
    kept = np.empty((n, 3))
    for c in range(cases):
        for i in range(n):
            for a in range(3):
                at[i, a] = rest[i, a] + before[c, i, a]
        contact = Contact(rest, radial, areas, at, offset, friction[c], compliance, own)
        outcome = Outcome(
            results[1, c], results[2, c], results[3, c], results[4, c], results[0, c], np.zeros(6)
        )
        thing = Touched(
            shape.kind, numbers[c], shape.grid, shape.origin, shape.cells, materials[c, 0],
            materials[c, 1], materials[c, 2], materials[c, 3],
        )  # fmt: skip
        pose = Pose(rotations[c, 0], places[c, 0], rotations[c, 1], places[c, 1])
        share, power = stiffening_by(law, materials[c, 1], areas, forces[c], friction[c])
        stiff = Stiffening(share, power, law[0])
        warm = c > 0 and errors[0] < tolerances[0]
        if warm:
            kept[:] = results[1, c]
            for i in range(n):
                for a in range(3):
                    results[1, c, i, a] += results[1, 0, i, a] - started[i, a]
            errors[c] = solve_contact(
                contact, thing, pose, stiff, 1.0, _HELD, _NO_INERTIA, _NO_WRENCH, tolerances[1],
                most_rounds, True, system, outcome,
            )[0]  # fmt: skip
            if errors[c] < tolerances[1]:
                continue
            results[1, c] = kept
        errors[c] = solve_contact(
            contact, thing, pose, stiff, 1.0, _HELD, _NO_INERTIA, _NO_WRENCH, tolerances[0],
            most_rounds, False, system, outcome,
        )[0]  # fmt: skip
