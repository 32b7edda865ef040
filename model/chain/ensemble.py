"""Many independent fingertips at once: one chain, with an object and a pose for each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit
from ..kernels.bordered_kernels import Scratch
from ..kernels.contact import Contact, contact_frame
from ..kernels.implicit_kernels import SOLVED, Record, Rule, advance
from .assembly import Chain, chain, lifts
from .fingertip import CONTACT_THRESHOLD, Fingertip
from .plant import IMPLICIT, NO_RECORD, _memory

Array = NDArray[np.float64]

#: Whether rigid part and object have a given position. As a literal in a kernel it would compile
#: `advance` again.
_HELD = (True, True)
#: Rule of `place_many`, for many copies that need not be exact: to 0.1 µm, and of first order, as
#: the motion before a step may have been one that is known only roughly.
_ROUGHLY = IMPLICIT._replace(tolerance=1e-7, second_order=False)
#: Shortest part of a step that is divided because it has no solution, and most tries.
_LEAST_PART, _MOST_TRIES = 1e-3, 60


class Ensemble(NamedTuple):
    """Stacked states of B fingertips with N nodes.

    Attributes
    ----------
    nodes: displacements (x, z) [m], shape (B, N, 2)
    pose: displacement of the rigid part along z and of the object along x [m], shape (B, 2)
    friction: Dahl force of each node [N], shape (B, N)
    """

    nodes: Array
    pose: Array
    friction: Array

    def take(self, rows: Sequence[int]) -> "Ensemble":
        """Some of the fingertips, in this order; they may repeat."""
        picked = np.asarray(rows)
        return self.each(lambda part: part[picked])

    def each(self, change: Callable[[Array], Array]) -> "Ensemble":
        """The same with each array changed, such as to combinations of the fingertips."""
        return Ensemble(*map(change, self))


def rest_ensemble(fingertip: Fingertip, count: int) -> Ensemble:
    """Ensemble of undeformed fingertips whose apex just touches the object.

    Parameters
    ----------
    fingertip: the same fingertip for all
    count: number of fingertips
    """
    n = fingertip.nodes
    return Ensemble(np.zeros((count, n, 2)), np.zeros((count, 2)), np.zeros((count, n)))


@dataclass(frozen=True, kw_only=True)
class Copies:
    """Parameters of B copies of a fingertip, each with an object of its own.

    Attributes
    ----------
    chain: parameters of the fingertip
    contacts: parameters of the objects, shape (B, 8)
    """

    chain: Chain
    contacts: Array

    def take(self, rows: Sequence[int]) -> "Copies":
        """Some of the copies, in this order; they may repeat."""
        return Copies(chain=self.chain, contacts=self.contacts[np.asarray(rows)])

    def sums(self, ensemble: Ensemble) -> Array:
        """ΣFn, and ΣFf along the object's tangent, of each copy [N], shape (B, 2)."""
        out = np.empty(ensemble.pose.shape)
        _sums_many(self.chain, self.contacts, *ensemble, out)
        return out


def copies_of(
    fingertip: Fingertip,
    *,
    friction: Array,
    curvature: Array,
    stiffness: Array,
    dahl_stiffness: Array,
    dahl_exponent: Array,
) -> Copies:
    """Make B copies of a fingertip, each with a flat or round object that travels.

    Parameters
    ----------
    fingertip: the same for all
    friction, curvature, stiffness, dahl_stiffness, dahl_exponent: as of `ContactObject`, shape (B,)

    Raises
    ------
    UserError
        When a hollow is too narrow for the fingertip to enter.
    """
    lift = lifts(fingertip, curvature)
    none, travels = np.zeros(len(friction)), np.ones(len(friction))
    columns = (stiffness, friction, dahl_stiffness, dahl_exponent, none, curvature, lift, travels)
    return Copies(chain=chain(fingertip), contacts=np.stack(columns, axis=1))


def place_many(
    copies: Copies, ensemble: Ensemble, poses: Array, dt: float
) -> tuple[Ensemble, NDArray[np.bool_]]:
    """Step every copy to a given position of its rigid part and object.

    Parameters
    ----------
    copies: B copies
    ensemble: B states to start from; not changed
    poses: position of the rigid part along z and of the object along x [m], shape (B, 2)
    dt: length of the step [s]

    Returns
    -------
    States, and which of them were found (B,); the others are of a shorter motion.
    """
    placed = ensemble.each(np.copy)
    solved = np.empty(len(poses), np.bool_)
    memory = _memory(copies.chain.rest.shape[0])
    _place_many(
        copies.chain, copies.contacts, memory, *placed, dt, _HELD,
        np.ascontiguousarray(poses, dtype=float), _ROUGHLY, NO_RECORD, solved,
    )  # fmt: skip
    return placed, solved


@njit()
def _place_many(
    ch: Chain, contacts: Array, w: Scratch, u: Array, pose: Array, friction: Array, dt: float,
    held: tuple[bool, bool], poses: Array, rule: Rule, nothing: Record, solved: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Do `place_many` in place; a step without solution is divided into halves."""
    no_knots, no_pieces = np.empty(0), np.empty((1, 4))
    goal, start = np.empty((1, 2)), np.empty(2)
    # A rule of first order does not use the motion before.
    slip, rate = np.zeros(u.shape[1]), np.zeros((u.shape[1] + 1, 2))
    for b in range(poses.shape[0]):
        c = contacts[b]
        ct = Contact(
            c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], no_knots, no_pieces, no_knots, no_knots
        )
        start[:] = pose[b]
        left, part, tries = 1.0, 1.0, 0
        while left > 0.0 and part >= _LEAST_PART and tries < _MOST_TRIES:
            part = min(part, left)
            goal[0] = start + (1.0 - left + part) * (poses[b] - start)
            _, ended = advance(
                ch, ct, w, u[b], friction[b], slip, pose[b], rate, part * dt, 0.0, held, goal,
                rule, nothing, 0, 2,
            )  # fmt: skip
            tries += 1
            if ended == SOLVED:
                left -= part
            else:
                part *= 0.5
        solved[b] = left <= 0.0


@njit()
def _sums_many(
    ch: Chain, contacts: Array, u: Array, pose: Array, friction: Array, out: Array
) -> None:
    """Do `Copies.sums`."""
    no_knots, no_pieces = np.empty(0), np.empty((1, 4))
    for b in range(u.shape[0]):
        stiffness, curvature, lift, travel = (
            contacts[b, 0], contacts[b, 5], contacts[b, 6], contacts[b, 7],
        )  # fmt: skip
        out[b] = 0.0
        for i in range(u.shape[1]):
            x, z = ch.rest[i, 0] + u[b, i, 0], ch.rest[i, 1] + u[b, i, 1]
            gap, _, _ = contact_frame(
                no_knots, no_pieces, curvature, x - travel * pose[b, 1], z - lift
            )
            normal = -stiffness * ch.share[i] * gap
            if normal > CONTACT_THRESHOLD * ch.share[i]:
                out[b, 0] += normal
                out[b, 1] += friction[b, i]
