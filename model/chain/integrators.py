"""Integrators of fingertip and object by name; `simulate` runs any of them."""

from dataclasses import replace
from typing import Protocol

import numpy as np

from ...by_name import Choice, Registry
from ...errors import UserError
from ..kernels.contact import Contact
from ..objects import ContactObject
from .assembly import Chain, chain, contact
from .dense import stable_step
from .drive import Drive
from .fingertip import Fingertip
from .plant import History
from .state import Deformation, State, rest_state

#: Name of an integrator.
Method = str


class Integrator(Protocol):
    """Steps a chain and its object in time; constructed by `Class()`."""

    def march(
        self,
        ch: Chain,
        ct: Contact,
        state: State,
        drive: Drive,
        dt: float,
        steps: int,
        every: int,
    ) -> History:
        """Run a number of steps; record the start and every `every`th step.

        Parameters
        ----------
        ch, ct: parameters of fingertip and object; see `assembly`
        state: state at the start
        drive: grip and load over time
        dt: step [s]; the longest one for an adaptive method
        steps, every: number of steps, and of steps between records

        Raises
        ------
        ModelError
            When a step has no solution.
        UserError
            For a half chain, if the integrator does not support it.
        """
        ...


#: Integrators by name.
INTEGRATORS = Registry(
    protocol=Integrator,
    package=__package__,
    entries={
        "implicit": (
            ".plant:Implicit",
            "default: BDF2, Newton on springs and contact, Dahl return map, block solve",
        ),
        "lagged": (
            ".plant:lagged",
            "semi-implicit: one linear solve a step, everything linearised at its start",
        ),
        "euler": (".dense:EULER", "dense baseline: forward Euler"),
        "rk4": (".dense:RK4", "dense baseline: classical Runge-Kutta"),
        "rk45": (".dense:RK45", "dense baseline: SciPy's adaptive Runge-Kutta"),
        "lsoda": (".dense:LSODA", "dense baseline: SciPy's LSODA"),
        "bdf": (".dense:BDF", "dense baseline: SciPy's BDF"),
    },
)


def simulate(
    fingertip: Fingertip,
    obj: ContactObject,
    drive: Drive,
    *,
    dt: float,
    duration: float,
    method: Choice | Integrator = "implicit",
    state: State | None = None,
    every: int = 1,
    half: bool = False,
    friction: bool = True,
) -> History:
    """Simulate the node model under a drive.

    Parameters
    ----------
    fingertip: chain
    obj: object
    drive: grip and load over time
    dt: step [s]; the longest one for the adaptive methods
    duration: length of the run, a whole number of steps [s]
    method: name in INTEGRATORS, `module:Class`, a class or other factory, or an Integrator (default
        `implicit`)
    state: state at the start (default: the undeformed fingertip at time 0)
    every: number of steps between records (default 1)
    half: whether only the right half is computed and mirrored; exact without lateral motion
    friction: whether friction is computed; False sets µ to 0

    Raises
    ------
    UserError
        For a step or a method that cannot be used, and for a half chain with lateral load.
    ModelError
        When the run fails; DivergedError if an explicit method diverged.
    """
    integrator: Integrator = INTEGRATORS.build(method)
    if not (np.isfinite([dt, duration]).all() and dt > 0.0 and duration > 0.0):
        raise UserError(f"dt and duration must be finite and above 0 s, got {dt=}, {duration=}")
    steps = round(duration / dt)
    if abs(steps * dt - duration) > 1e-6 * dt or every < 1 or steps % every:
        raise UserError(
            f"the duration must be a whole number of recorded steps, got {duration=}, {dt=}, "
            f"{every=}"
        )
    start = rest_state(fingertip) if state is None else state
    if len(start.friction) != fingertip.nodes:
        raise UserError(
            f"the state has {len(start.friction)} nodes and the fingertip {fingertip.nodes}"
        )
    ct = contact(fingertip, obj)
    if not friction:
        ct = ct._replace(mu=0.0)
    if half:
        return _march_half(fingertip, obj, ct, start, drive, dt, steps, every, integrator)
    return integrator.march(chain(fingertip), ct, start, drive, dt, steps, every)


def explicit_limit(
    fingertip: Fingertip, obj: ContactObject, state: State, method: Method = "euler"
) -> float:
    """Largest step at which linear theory keeps an explicit method stable, 2c/λmax for Euler [s].

    λmax/c is the largest eigenvalue of C⁻¹·J at the state; C is the damping and J the stiffness of
    springs, contact and sticking friction.
    """
    return stable_step(chain(fingertip), contact(fingertip, obj), state, method)


def _march_half(
    fingertip: Fingertip,
    obj: ContactObject,
    ct: Contact,
    start: State,
    drive: Drive,
    dt: float,
    steps: int,
    every: int,
    integrator: Integrator,
) -> History:
    """Run the right half on a mirror plane, and mirror the result to the left."""
    if drive.lateral.any() or start.deformation.object_position != 0.0:
        raise UserError("a half chain needs a drive and a state without lateral load or motion")
    if obj.profile is not None and not _mirrors(obj.profile):
        raise UserError("a half chain needs an object that mirrors itself about x = 0")
    if obj.patches and not np.allclose(obj.patches, np.array(obj.patches)[::-1] * [-1.0, 1.0]):
        raise UserError("a half chain needs patches of friction that mirror themselves")
    ch = chain(fingertip, half=True)
    middle = fingertip.nodes // 2
    d = start.deformation
    right = State(
        time=start.time,
        deformation=Deformation(
            nodes=d.nodes[middle:], rigid_part=d.rigid_part, object_position=0.0
        ),
        friction=start.friction[middle:],
        slip_rate=start.slip_rate[middle:],
        rate=start.rate[middle:],
        step=start.step,
    )
    # The mirror plane holds the object; the other half carries its half of the grip.
    share = 0.5 if drive.normal_control == "force" else 1.0
    halved = replace(drive, normal=share * drive.normal, lateral_control="position")
    return _mirrored(integrator.march(ch, ct, right, halved, dt, steps, every))


def _mirrors(profile: tuple[tuple[float, float], ...]) -> bool:
    """Whether a profile is symmetric about x = 0."""
    points = np.array(profile)
    return bool(np.allclose(points, points[::-1] * [-1.0, 1.0], atol=1e-12))


def _mirrored(run: History) -> History:
    """Mirror the run of a half chain: x, friction and slip change their sign on the left."""
    flip = np.array([-1.0, 1.0])
    rate = run.rate
    return replace(
        run,
        nodes=np.concatenate([run.nodes[:, :0:-1] * flip, run.nodes], axis=1),
        friction=np.concatenate([-run.friction[:, :0:-1], run.friction], axis=1),
        slip_rate=np.concatenate([-run.slip_rate[:, :0:-1], run.slip_rate], axis=1),
        rate=np.concatenate([rate[:, -2:0:-1] * flip, rate], axis=1),
    )
