"""What a grip can hold by analysis: the loop, the lag of a reaction, and the limit surface."""

import math
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from ....loop.dome_world import PRESS_DRAG
from ....model import Motion, dome_forces, simulate_contact, torsion
from ....model.shapes import plane
from ....scene.scene import Scene
from ..linear import LinearLoop, Plant, critical_period
from .cells import FIRST_SHARE, GripSetting

#: Gravity [m/s²].
G = 9.81
#: Time in which a press is made and settles [s], and the step of the force that tells stiffness.
_PRESSED = 0.3
_MORE = 0.02


class Press(NamedTuple):
    """A plane pressed on a dome, without a pull.

    Attributes
    ----------
    way: of the plane towards the dome, from its middle [m]
    torsion: that friction bears, over µ·ΣFn [m]; 3π/16 of the radius for a contact of Hertz
    """

    way: float
    torsion: float


@cache
def pressed(world: str, force: float) -> Press:
    """Press of a world's dome under a force [N]."""
    scene = GripSetting(world=world).scene()
    dome, solid = scene.build_dome(), replace(scene.build_solid(), shape=plane())
    loads = np.zeros((3, 6))
    loads[1:, 2] = -force
    motion = Motion(
        times=np.array([0.0, 0.5 * _PRESSED, _PRESSED]),
        poses=np.zeros((3, 6)),
        free=("z",),
        loads=loads,
        drag=(0.0, 0.0, PRESS_DRAG, 0.0, 0.0, 0.0),
    )
    contact = simulate_contact(dome, solid, motion, dt=5e-3)
    field = dome_forces(dome, contact.end)
    return Press(-float(contact.places[-1, 2]), torsion(field)[2] / field.total_normal)


def pull(setting: GripSetting) -> float:
    """Lightest load that one finger holds at rest, where the plant's gain is largest [N]."""
    return {
        "dome": FIRST_SHARE * setting.load_n,
        "pinch": 0.5e-3 * setting.mass_g * G,
    }[setting.world]


def linear(setting: GripSetting) -> LinearLoop:
    """Safety Margin's loop around the desired margin; the lag is that of the drive's damper."""
    gains = setting.scene().safety_margin
    friction, load = setting.friction, pull(setting)
    grip = load / (friction * (1.0 - gains.desired_margin))
    more = pressed(setting.world, (1.0 + _MORE) * grip).way - pressed(setting.world, grip).way
    return LinearLoop(
        plant=Plant(
            gain=(1.0 - gains.desired_margin) ** 2 * friction / load,
            lag=PRESS_DRAG * more / (_MORE * grip),
        ),
        proportional=gains.proportional_n,
        integral=gains.integral_n_per_s,
        period=1.0 / setting.rate_hz,
        latency=setting.latency_frames,
    )


def slowest_rate(setting: GripSetting) -> float:
    """Camera rate below which Safety Margin's loop is not stable, at the latency [Hz]."""
    return 1.0 / critical_period(linear(setting))


def heaviest(friction: float, grip: float) -> float:
    """Mass that two fingers bear by friction under a grip [g]: m·g/2 = µ·F."""
    return 1e3 * 2.0 * friction * grip / G


def farthest(setting: GripSetting, grip: float) -> float:
    """Offset of the centre of mass at which a grip [N] reaches the limit surface [mm].

    Friction and torsion of a finger, each over what is borne of it alone, are on an ellipse:
    (m·g/2 / µF)² + (m·g·c/2 / µFl)² = 1, with l = `Press.torsion`. NaN where the weight alone is
    too much.
    """
    bound = setting.friction * grip
    share = pull(setting) / bound
    if share >= 1.0:
        return math.nan
    length = pressed(setting.world, grip).torsion
    return 1e3 * length * bound * math.sqrt(1.0 - share**2) / pull(setting)


def slide_time(setting: GripSetting) -> float:
    """Time from the lift until the hand has gone as far as counts as dropped [s].

    So long an object that is too heavy for its grip stands on the table while the hand rises.
    """
    pinch = setting.scene().pinch
    hand, start = pinch.build_hand(), pinch.lifts_at

    def short(time: float) -> float:
        way = hand.at(start + time)[0] - hand.at(start)[0]
        return float(np.linalg.norm(way)) - 1e-3 * pinch.dropped_mm

    return float(brentq(short, 1e-6, pinch.hand_times_s[-1] - start))


def reached(setting: GripSetting) -> float:
    """Grip that a controller reaches at least until an object that slides counts as dropped [N].

    A slide is Γ = 0. Safety Margin then rises by Ki·Γ_des a second; it sees less than 0, and rises
    faster, for as long as its average of µ has not come up to the true one. Margin Inversion, told
    of the friction µ·F, commands F/(1 − Γ_des), and anew each time that it sees what this did.
    React To Slip adds its step for each of its displacements.
    """
    scene = setting.scene()
    start, most = grip_range(scene)
    delay = (setting.latency_frames + 1) / setting.rate_hz
    left = slide_time(setting)
    if scene.controller == "safety-margin":
        gains = scene.safety_margin
        rise = gains.proportional_n + gains.integral_n_per_s * max(left - delay, 0.0)
        return start + gains.desired_margin * rise
    if scene.controller == "margin-inversion":
        rounds = math.floor(left / delay)
        return min(start / (1.0 - scene.margin_inversion.desired_margin) ** rounds, most)
    if scene.controller == "react-to-slip":
        slip = scene.react_to_slip
        return start + slip.step_n * math.floor(scene.pinch.dropped_mm / slip.displacement_mm)
    return start


def slowest_reaction(setting: GripSetting) -> float:
    """Camera rate below which a reaction is too late for a weight, at the latency [Hz].

    Safety Margin needs one command in time at least, Margin Inversion one for each of its rises.
    NaN where the grip of the start bears the weight.
    """
    scene = setting.scene()
    short = setting.mass_g / heaviest(setting.friction, grip_range(scene)[0])
    if short <= 1.0:
        return math.nan
    rounds = 1
    if scene.controller == "margin-inversion":
        rise = -math.log(1.0 - scene.margin_inversion.desired_margin)
        rounds = math.ceil(math.log(short) / rise)
    return rounds * (setting.latency_frames + 1) / slide_time(setting)


def grip_range(scene: Scene) -> tuple[float, float]:
    """Grip with which the lift begins, and the largest one [N].

    On the table nothing pulls, Γ is 1, and Safety Margin opens to its floor. With the true forces,
    it and React To Slip have no largest grip.
    """
    if scene.controller == "conservative":
        return scene.conservative.force_n, scene.conservative.force_n
    if scene.controller == "margin-inversion":
        return scene.margin_inversion.start_n, scene.margin_inversion.ceiling_n
    if scene.controller == "react-to-slip":
        return scene.react_to_slip.start_n, math.inf
    return scene.safety_margin.floor_n, math.inf
