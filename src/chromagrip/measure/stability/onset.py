"""Where the real loop starts to oscillate, from a small disturbance of a held grasp."""

import math
from collections import deque
from dataclasses import replace

import numpy as np

from ...control import GripObservation, SafetyMarginControl, SafetyMarginSettings
from ...loop.observers import TruthObserver
from ...model import ContactObject, Fingertip, State, contact_forces, step
from .cells import FIRST_LOAD, MARGIN, Setting
from .linear import critical_period, held

#: The disturbance: the grip is off by this share until the first command from what it did.
_KICK = 0.02
#: Delays for which its echo is followed, and at least and at most how long [s].
_DELAYS, _SHORTEST, _LONGEST = 60, 0.1, 1.5
#: Periods that are searched, as shares of the predicted one, and halvings of that range.
_SEARCHED, _HALVINGS = (0.4, 2.5), 7


def onset(setting: Setting) -> float:
    """Shortest period at which a small disturbance grows, on the node model [s].

    NaN where it grows, or does not, at every period around the predicted one.
    """
    scene = setting.scene()
    tip, obj = scene.build_fingertip(), scene.build_object()
    state, _, grip = held(tip, obj, FIRST_LOAD, MARGIN)
    predicted = critical_period(setting.linear())
    low, high = (share * predicted for share in _SEARCHED)
    if _grows(setting, tip, obj, state, grip, low) or not _grows(
        setting, tip, obj, state, grip, high
    ):
        return math.nan
    for _ in range(_HALVINGS):
        middle = math.sqrt(low * high)
        if _grows(setting, tip, obj, state, grip, middle):
            high = middle
        else:
            low = middle
    return math.sqrt(low * high)


def _grows(
    setting: Setting, tip: Fingertip, obj: ContactObject, state: State, grip: float, period: float
) -> bool:
    """Whether the margin strays further at the end than the disturbance itself put it off by."""
    gains = SafetyMarginSettings(
        desired_margin=contact_forces(tip, obj, state).safety_margin(obj.friction),
        feedforward_n=grip,
        proportional_n=setting.proportional_n,
        integral_n_per_s=setting.integral_n_per_s,
        start_s=0.0,
    )
    controller, observer = SafetyMarginControl(gains), TruthObserver(setting.window_s)
    delay = (setting.latency_frames + 1) * period
    count = round(min(max(_DELAYS * delay, _SHORTEST), _LONGEST) / period)
    substeps = math.ceil(1e3 * period - 1e-9)
    dt = period / substeps
    waiting: deque[GripObservation] = deque()
    state, force = replace(state, time=0.0), (1.0 + _KICK) * grip
    strayed = np.zeros(count)
    for k in range(count):
        seen = observer.observe(k * period, contact_forces(tip, obj, state), math.nan)
        strayed[k] = abs(seen.margin - gains.desired_margin)
        waiting.append(seen)
        if k > setting.latency_frames:  # the first frame shows the grasp before the disturbance
            force = controller.command(waiting.popleft()).force
        for _ in range(substeps):
            state = step(tip, obj, state, dt, force, FIRST_LOAD)
    return bool(strayed[-(count // 4) :].max() > _KICK * (1.0 - MARGIN))
