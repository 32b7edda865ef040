"""The grip loop linearised around a held grasp: when it oscillates, and its gain for noise.

Around a held load the margin follows the grip force F through Fn: δΓ = g·δFn, g = (1 − Γ)²·µ/Ff,
and Fn follows F with a first-order lag τ, which is dampers over contact stiffness. Samples come
every T, a command rests on the sample L frames before, holds until the next, and is the sum of
Kp·e and Ki·T·Σe with e = Γ_des − Γ. With a = exp(−T/τ) that is

    (z − a)·(z − 1)·z^L + (1 − a)·g·(Kp·(z − 1) + Ki·T·z) = 0,

stable while every root lies inside the unit circle. Two effects are left out. The moving average
of µ is taken as constant, which it is where it is longer than the swing; a shorter one follows the
ratios as they sink under a rising grip, and so weakens the loop. Friction depends on the past:
under a falling grip the skin slips, and until the object has crept on against its drag, Γ responds
by half.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from ...model import ContactObject, Drive, Fingertip, ForceField, State, contact_forces, simulate

#: Times by which the grasp whose plant is measured is pressed, loaded and settled [s].
_PRESSED = 0.05
_LOADED = 0.15
_SETTLED = 0.9
#: Rounds in which the grip for a margin is found: on round objects ΣFn is not the grip.
_ROUNDS = 3
#: Step of the grip from which the lag is measured, as a share of the grip.
_STEP = 0.01
#: Time for which its effect is followed, and time step [s].
_FOLLOWED = 0.06
_FINE = 5e-4
#: Points on the unit circle over which noise is summed.
_CIRCLE = 4096
#: Values between which the first crossing is searched.
_TRIED = 81
#: Periods [s] and integral gains [N/s] that are searched for a boundary.
PERIODS = (1e-5, 1.0)
INTEGRALS = (1e-2, 1e5)


@dataclass(frozen=True, kw_only=True)
class Plant:
    """A held grasp as the loop measures it.

    Attributes
    ----------
    gain: g, of the margin over the grip [1/N]
    lag: τ, of ΣFn behind the grip [s]
    """

    gain: float
    lag: float


@dataclass(frozen=True, kw_only=True)
class LinearLoop:
    """The plant with its controller.

    Attributes
    ----------
    plant: of the held grasp
    proportional: Kp [N]
    integral: Ki [N/s]
    period: T, between frames [s]
    latency: L, frames between an image and the command from it
    """

    plant: Plant
    proportional: float
    integral: float
    period: float
    latency: int

    @property
    def delay(self) -> float:
        """Time from an event to the first command that can depend on it [s]."""
        return (self.latency + 1) * self.period


def characteristic(loop: LinearLoop) -> NDArray[np.float64]:
    """Coefficients of the characteristic polynomial, highest power first, shape (L + 3,)."""
    a = np.exp(-loop.period / loop.plant.lag)
    polynomial = np.zeros(loop.latency + 3)
    polynomial[:3] = 1.0, -1.0 - a, a
    reach = (1.0 - a) * loop.plant.gain
    polynomial[-2:] += (
        reach * (loop.proportional + loop.integral * loop.period),
        -reach * loop.proportional,
    )
    return polynomial


def largest_root(loop: LinearLoop) -> float:
    """Modulus of the largest root: a disturbance shrinks, or grows, by it from frame to frame."""
    return float(abs(np.roots(characteristic(loop))).max())


def critical_period(loop: LinearLoop) -> float:
    """Shortest period at which the loop is not stable, at its latency [s]."""
    return _first_unstable(lambda value: replace(loop, period=value), *PERIODS)


def critical_integral(loop: LinearLoop) -> float:
    """Smallest Ki at which the loop is not stable [N/s]; 0 if it is not at any."""
    return _first_unstable(lambda value: replace(loop, integral=value), *INTEGRALS)


def critical_gain(loop: LinearLoop) -> float:
    """Smallest gain of the plant with which the loop is not stable [1/N]."""
    return _first_unstable(
        lambda value: replace(loop, plant=replace(loop.plant, gain=value)), 1e-3, 1e3
    )


def _first_unstable(at: Callable[[float], LinearLoop], low: float, high: float) -> float:
    """First of the growing values at which a loop is not stable; 0 or ∞ outside the range."""
    tried = np.geomspace(low, high, _TRIED).tolist()
    growth = [largest_root(at(value)) - 1.0 for value in tried]
    first = next((k for k, each in enumerate(growth) if each >= 0.0), None)
    if first is None:
        return np.inf
    bracket = tried[first - 1 : first + 1]
    return brentq(lambda value: largest_root(at(value)) - 1.0, *bracket) if first else 0.0


def noise_gain(loop: LinearLoop) -> float:
    """Standard deviation of the command over that of white noise on the margin [N].

    ∞ for a loop that is not stable.
    """
    if largest_root(loop) >= 1.0:
        return np.inf
    z = np.exp(2j * np.pi * (np.arange(_CIRCLE) + 0.5) / _CIRCLE)
    a = np.exp(-loop.period / loop.plant.lag)
    answer = (z - a) * (loop.proportional * (z - 1.0) + loop.integral * loop.period * z)
    return float(np.sqrt((abs(answer / np.polyval(characteristic(loop), z)) ** 2).mean()))


def held(
    tip: Fingertip, obj: ContactObject, load: float, margin: float
) -> tuple[State, ForceField, float]:
    """A grasp of a load [N] at that margin, settled: state, forces and grip force [N]."""
    times = np.array([0.0, _PRESSED, _LOADED, _SETTLED])
    grip = load / (obj.friction * (1.0 - margin))
    for _ in range(_ROUNDS):
        drive = Drive(
            times=times,
            normal=np.array([0.02, grip, grip, grip]),
            lateral=np.array([0.0, 0.0, load, load]),
        )
        steps = round(_SETTLED / 2e-3)
        run = simulate(tip, obj, drive, dt=2e-3, duration=_SETTLED, every=steps)
        state = run.state(-1)
        field = contact_forces(tip, obj, state)
        used, grip = grip, grip * (1.0 - field.safety_margin(obj.friction)) / (1.0 - margin)
    return state, field, used


def plant_of(tip: Fingertip, obj: ContactObject, load: float, margin: float) -> Plant:
    """The plant around a held load [N]: its gain by the formula, its lag from the node model.

    The lag is the time by which ΣFn trails a small step of the grip: the area between both over
    the height of the step.
    """
    state, field, grip = held(tip, obj, load, margin)
    run = simulate(
        tip,
        obj,
        Drive.constant((1.0 + _STEP) * grip, load),
        dt=_FINE,
        duration=_FOLLOWED,
        state=state,
    )
    normal = np.array(
        [contact_forces(tip, obj, run.state(k)).total_normal for k in range(len(run))]
    )
    behind = (normal[-1] - normal) / (normal[-1] - normal[0])
    reached = field.safety_margin(obj.friction)
    return Plant(
        gain=(1.0 - reached) ** 2 * obj.friction / field.total_friction,
        lag=float(np.trapezoid(behind, dx=_FINE)),
    )
