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
#: Positions to less than a thousandth of a micrometre cost more than they teach.
RULE = IMPLICIT._replace(tolerance=5e-8)


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
    number: number of the history; 32 successive ones share a specimen
    """
    of_one = 32  # histories of one specimen, one after the other
    specimen = random_specimen(np.random.default_rng([76, number // of_one]), fingertip)
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
    every = 2  # number of steps from one instant that may be kept to the next
    run = march(*numbers, rest_state(tip), drive, plan.dt, steps, every, RULE)
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
    # An instant is soon after a change of grip or load by this share of the friction limit …
    change_share = 0.1
    soon_s = 0.02  # … for this time [s]
    soon = _within(change > change_share, round(soon_s / period))
    still_share = 2e-3  # it is a rest where they have changed by no more than this share
    long_s = 0.08  # … for this time [s]
    still = ~_within(change > still_share, round(long_s / period))
    still[time < long_s] = False
    known = ~np.isnan(margin)
    events, rests, every = (rng.permutation(np.flatnonzero(k & known)) for k in (soon, still, True))
    most_events = 3  # taken first: some soon after a change
    most_rests = 2  # … and some that have rested for long, beside the last such
    first = [*events[:most_events], *np.sort(rests)[-1:], *rests[:most_rests]]
    # Most of the others in each bin of Γ from 0 to 1, and of all of them in the last one: many
    # histories rest without a load, of which few suffice.
    in_bin = (4, 4, 4, 4, 4, 3, 2, 1)
    free = list(in_bin)
    found: list[int] = []
    kept_at_most = 12  # instants kept of a history
    for order, index in enumerate(map(int, [*first, *every])):
        place = int(np.clip(margin[index] * len(free), 0, len(free) - 1))
        wanted = order < len(first) and place < len(free) - 1
        if (wanted or free[place] > 0) and index not in found and len(found) < kept_at_most:
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
