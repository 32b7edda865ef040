"""Static equilibrium, by steps so long that dampers and drag carry almost no force.

Friction depends on how the contact grew, so that a static solution belongs to a loading path: the
grip is raised first, then the load, each in equal parts (thesis Fig. 10: press, then pull).
"""

from dataclasses import replace

import numpy as np

from ...errors import UserError, located
from ..errors import ConvergenceError, NoEquilibriumError, PiercedError
from ..objects import ContactObject
from .assembly import chain, contact
from .drive import Drive
from .fingertip import Fingertip
from .plant import IMPLICIT, march
from .state import State, rest_state

#: Step of the path [s], in which dampers and drag carry a 1e-7th of the forces. A part in which a
#: spring snaps through is halved until the dampers hold it.
LONG = 1e4
QUASI_STATIC = IMPLICIT._replace(second_order=False)


def largest_grip(fingertip: Fingertip, obj: ContactObject) -> float:
    """Grip force at which a flat object would press the whole dome flat [N].

    Tissue springs then have no remaining length, and the model no meaning. A node at height zᵢ has
    travelled zᵢ, against its tissue spring kᵢ and the object's spring k_c in series:
    F = Σ zᵢ·kᵢ·k_c/(kᵢ + k_c). As tissue also moves sideways, the model rather fails below this
    force than above. With a sharp object it fails at a fraction of it (`PiercedError`).
    """
    ch = chain(fingertip)
    object_springs = obj.stiffness * ch.share
    in_series = ch.tissue * object_springs / (ch.tissue + object_springs)
    return float(in_series @ ch.rest[:, 1])


def refuse_flattening(fingertip: Fingertip, obj: ContactObject, grip: float) -> None:
    """Refuse a grip force [N] that the node model cannot describe.

    Raises
    ------
    PiercedError
        When it is above `largest_grip`.
    """
    limit = largest_grip(fingertip, obj)
    if grip > limit:
        raise PiercedError(
            f"grip {grip:g} N is above {limit:.3g} N, which press the whole fingertip flat"
        )


def equilibrium(
    fingertip: Fingertip,
    obj: ContactObject,
    grip: float,
    load: float = 0.0,
    *,
    state: State | None = None,
    parts: int = 40,
) -> State:
    """Solve for the static state after raising the grip and then the load.

    Parameters
    ----------
    fingertip, obj: chain and object
    grip: force on the rigid part along z, above 0 [N]
    load: force on the object along x (default 0) [N]
    state: state to start from, loaded in one part (default: rest, loaded in `parts`)
    parts: number of equal parts in which grip and load are each raised from 0 (default 40)

    Raises
    ------
    NoEquilibriumError
        When friction cannot hold the load, so that the object keeps sliding.
    PiercedError
        When the object is too soft for the grip.
    ConvergenceError
        When the forces were not balanced.
    """
    if not (np.isfinite([grip, load]).all() and grip > 0.0):
        raise UserError(f"an equilibrium needs grip > 0 and finite forces, got {grip=}, {load=}")
    if parts < 1:
        raise UserError(f"parts must be at least 1, got {parts!r}")
    ch, ct = chain(fingertip), contact(fingertip, obj)
    now = start = replace(rest_state(fingertip) if state is None else state, time=0.0, step=0.0)
    if state is None:
        stages = 2 if load else 1
        path = Drive(
            times=np.array([0.0, parts, stages * parts]) * LONG,
            normal=np.array([0.0, grip, grip]),
            lateral=np.array([0.0, 0.0, load]),
        )
        steps = stages * parts
        with located("on the way to these forces"):
            now = march(ch, ct, start, path, LONG, steps, steps, QUASI_STATIC).state(-1)
    goal = Drive.constant(grip, load)
    for _ in range(50):
        before = now
        now = march(ch, ct, before, goal, LONG, 1, 1, QUASI_STATIC).state(-1)
        pose = now.deformation.object_position - before.deformation.object_position
        moved = abs(now.deformation.nodes - before.deformation.nodes).max()
        if max(abs(pose), moved) < 1e-9:  # [m] in a step so long that it is in balance
            time = 0.0 if state is None else state.time
            return replace(now, time=time, rate=np.zeros_like(now.rate), step=0.0)
        if abs(pose) > fingertip.radius:
            raise NoEquilibriumError(
                f"the object slides: friction {obj.friction:g} under a grip of {grip:g} N does not "
                f"hold a load of {load:g} N"
            )
    raise ConvergenceError(f"no equilibrium found with a grip of {grip:g} N, load {load:g} N")
