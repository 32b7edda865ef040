"""Random grips and loads on random objects, on which a read-out is trained."""

from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..model import ContactObject, Drive, Fingertip, History, ModelError, rest_state
from ..model.chain import IMPLICIT, chain, contact, march
from ..model.kernels import contact_frames
from .random_grips import DRIVES, ONSET, random_drive
from .ranges import SHAPES, Contact, random_contact, random_specimen

Array = NDArray[np.float64]

#: Steps of the plant [s], and how many a history has: one of these, from 0.2 s to 0.56 s.
STEPS = ((2e-3, 100), (4e-3, 80), (4e-3, 80), (8e-3, 70))
#: Number of steps from one instant that may be kept to the next.
EVERY = 2
#: Histories of one specimen, one after the other.
SPECIMEN = 32
#: Positions to less than a thousandth of a micrometre cost more than they teach.
RULE = IMPLICIT._replace(tolerance=5e-8)
#: Instants kept of a history …
_KEPT = 12
#: … at first some soon after a change, and some that have rested for long, beside the last such.
_EVENTS, _RESTS = 3, 2
#: Most of the others in each bin of Γ from 0 to 1, and of all of them in the last one: many
#: histories rest without a load, of which few suffice.
_IN_BIN = (4, 4, 4, 4, 4, 3, 2, 1)
#: An instant is soon after a change of grip or load by this share of the friction limit …
_CHANGE = 0.1
#: … for this time [s].
_SOON = 0.02
#: It is a rest where they have changed by no more than this share …
_STILL = 2e-3
#: … for this time [s].
_LONG = 0.08


@dataclass(frozen=True, kw_only=True)
class Snapshots:
    """Instants of many histories.

    Attributes
    ----------
    displacement: of the nodes relative to the rigid part [m], shape (S, N, 2)
    normal, friction: true nodal forces [N], shape (S, N)
    totals: true ΣFn, signed ΣFf [N] and µ, shape (S, 3)
    history: number of the history, shape (S,)
    material: σ0 [N/m], n and k_c [N/m] of the object, shape (S, 3)
    kind: number of the shape times the number of DRIVES, plus that of the drive, shape (S,)
    """

    displacement: NDArray[np.float32]
    normal: NDArray[np.float32]
    friction: NDArray[np.float32]
    totals: Array
    history: NDArray[np.int64]
    material: Array
    kind: NDArray[np.int64]


class Plan(NamedTuple):
    """Specimen, object, drive, kind and step [s] of a history."""

    fingertip: Fingertip
    contact: Contact
    drive: Drive
    kind: int
    dt: float


def random_plan(fingertip: Fingertip, number: int) -> Plan:
    """Draw specimen, object and drive of a history; the same number gives the same plan.

    Parameters
    ----------
    fingertip: nominal fingertip
    number: number of the history; SPECIMEN successive ones share a specimen
    """
    specimen = random_specimen(np.random.default_rng([76, number // SPECIMEN]), fingertip)
    rng = np.random.default_rng([77, number])
    touched = random_contact(rng, specimen)
    dt, steps = STEPS[rng.integers(len(STEPS))]
    drive, name = random_drive(rng, touched, dt * np.arange(steps + 1.0))
    kind = list(SHAPES).index(touched.shape) * len(DRIVES) + list(DRIVES).index(name)
    return Plan(specimen, touched, drive, kind, dt)


def snapshots(fingertip: Fingertip, numbers: range) -> Snapshots:
    """Instants of the histories of these numbers; the same number gives the same history.

    A history that the plant cannot follow to its end is left out.
    """
    found = [_none(fingertip.nodes)]
    for number in numbers:
        with suppress(ModelError):
            found.append(of_plan(random_plan(fingertip, number), number))
    return _joined(found)


def of_plan(plan: Plan, number: int) -> Snapshots:
    """Instants of one history.

    Parameters
    ----------
    plan: what it is of
    number: of the history, by which the instants are chosen

    Raises
    ------
    ModelError
        When the plant cannot follow it.
    """
    tip, obj, drive = plan.fingertip, plan.contact.obj, plan.drive
    steps = len(drive.times) - 1
    numbers = chain(tip), contact(tip, obj)
    run = march(*numbers, rest_state(tip), drive, plan.dt, steps, EVERY, RULE)
    normal = normal_forces(tip, obj, run)
    touching = normal > tip.contact_threshold
    press = (normal * touching).sum(axis=1)
    drag = (run.friction * touching).sum(axis=1)
    usable = touching.any(axis=1) & (run.time > ONSET / 2)
    margin = np.full(len(run), np.nan)
    margin[usable] = 1.0 - abs(drag[usable]) / (obj.friction * press[usable])
    rng = np.random.default_rng([79, number])
    kept = choose(rng, run.time, margin, obj.friction, drive.at(run.time))
    count = len(kept)
    seen = run.nodes[kept]
    seen[..., 1] -= run.pose[kept, :1]
    material = [obj.dahl_stiffness, obj.dahl_exponent, obj.stiffness]
    return Snapshots(
        displacement=seen.astype(np.float32),
        normal=normal[kept].astype(np.float32),
        friction=run.friction[kept].astype(np.float32),
        totals=np.column_stack([press[kept], drag[kept], np.full(count, obj.friction)]),
        history=np.full(count, number),
        material=np.tile(material, (count, 1)),
        kind=np.full(count, plan.kind),
    )


def normal_forces(fingertip: Fingertip, obj: ContactObject, run: History) -> Array:
    """Normal force on each node at each instant of a run [N], as in `contact_forces`, (R, N)."""
    ch = chain(fingertip)
    points = ch.rest + run.nodes
    points[..., 0] -= run.pose[:, 1:]
    gap, _ = contact_frames(contact(fingertip, obj), points.reshape(-1, 2), 0.0)
    forces: Array = obj.stiffness * ch.share * np.maximum(0.0, -gap.reshape(len(run), -1))
    return forces


def choose(
    rng: np.random.Generator, time: Array, margin: Array, friction: float, forces: Array
) -> NDArray[np.int64]:
    """Instants to keep: soon after changes, after long rests, and others, spread over Γ.

    Parameters
    ----------
    rng: source
    time: of the instants [s], shape (R,)
    margin: Γ; NaN where an instant cannot be kept, shape (R,)
    friction: µ
    forces: grip and load [N], shape (R, 2)
    """
    limit = friction * forces[:, 0]
    change = (abs(np.diff(forces, axis=0)) * [friction, 1.0]).sum(axis=1) / limit[1:]
    period = float(time[1] - time[0])
    soon = _within(change > _CHANGE, round(_SOON / period))
    still = ~_within(change > _STILL, round(_LONG / period))
    still[time < _LONG] = False
    known = ~np.isnan(margin)
    events, rests, every = (rng.permutation(np.flatnonzero(k & known)) for k in (soon, still, True))
    first = [*events[:_EVENTS], *np.sort(rests)[-1:], *rests[:_RESTS]]
    free = list(_IN_BIN)
    found: list[int] = []
    for order, index in enumerate(map(int, [*first, *every])):
        place = int(np.clip(margin[index] * len(free), 0, len(free) - 1))
        wanted = order < len(first) and place < len(free) - 1
        if (wanted or free[place] > 0) and index not in found and len(found) < _KEPT:
            free[place] -= 1
            found.append(index)
    return np.array(found, dtype=np.int64)


def _within(happens: NDArray[np.bool_], count: int) -> NDArray[np.bool_]:
    """Instants with an event among the last few steps, shape (steps + 1,) for (steps,)."""
    total = np.concatenate([[0], np.cumsum(happens)])
    before = np.concatenate([np.zeros(count, dtype=int), total])[: len(total)]
    recent: NDArray[np.bool_] = total > before
    return recent


def _none(nodes: int) -> Snapshots:
    """No instant."""
    return Snapshots(
        displacement=np.zeros((0, nodes, 2), dtype=np.float32),
        normal=np.zeros((0, nodes), dtype=np.float32),
        friction=np.zeros((0, nodes), dtype=np.float32),
        totals=np.zeros((0, 3)),
        history=np.zeros(0, dtype=np.int64),
        material=np.zeros((0, 3)),
        kind=np.zeros(0, dtype=np.int64),
    )


def _joined(parts: list[Snapshots]) -> Snapshots:
    names = vars(parts[0])
    return Snapshots(**{k: np.concatenate([vars(part)[k] for part in parts]) for k in names})
