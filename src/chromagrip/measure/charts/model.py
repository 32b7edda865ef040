"""Time per simulated second of the node models against their error."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model import ContactObject, Fingertip, History, Method, explicit_limit, rest_state, simulate
from ..bench.model import SAFE, margins, smooth_grasp
from .chart import Axis, Chart, Point

Array = NDArray[np.float64]

#: Length of a grasp [s].
DURATION = 1.2
#: Time between the instants of a grasp that are compared [s].
_EVERY = 0.3
#: Flat and hard, in between, sharp and soft.
_OBJECTS = (
    ContactObject(friction=0.5, stiffness=1000.0),
    ContactObject(friction=0.3, stiffness=160.0, curvature=50.0),
    ContactObject(friction=0.7, stiffness=80.0, curvature=200.0),
)
#: Grip force of the grasp [N].
_GRIP = 2.0
AXES = (
    Axis(key="normal_error", label="ΣFn, largest error [%]", unit="%"),
    Axis(key="margin_error", label="Γ, largest error", unit=""),
)


@dataclass(frozen=True)
class Setting:
    """A chain and how it is stepped; an explicit method takes SAFE of its stable step."""

    name: str
    tip: Fingertip
    step: float = 1e-3
    method: Method = "implicit"

    def run(self, obj: ContactObject) -> History:
        """A grasp, with the instants that are compared."""
        step = self.step
        if self.method != "implicit":
            step = SAFE * explicit_limit(self.tip, obj, rest_state(self.tip), self.method)
        every = int(np.ceil(_EVERY / step))
        drive = smooth_grasp(_GRIP, 0.5 * obj.friction * _GRIP)
        return simulate(
            self.tip, obj, drive, dt=_EVERY / every, duration=DURATION, every=every,
            method=self.method,
        )  # fmt: skip


def _settings(quick: bool) -> list[Setting]:
    thesis, graded = Fingertip(), Fingertip.graded()
    chains = {"31": Fingertip(nodes=31), "51": Fingertip(nodes=51), "101": Fingertip(nodes=101)}
    chains |= {"251": thesis, f"{graded.nodes} graded": graded}
    steps = (2e-3, 1e-2) if quick else (1e-3, 5e-3, 1e-2, 2e-2)
    settings = [
        Setting(f"{name} nodes, {1e3 * step:g} ms", tip, step)
        for name, tip in chains.items()
        for step in steps
    ]
    if not quick:
        settings += [
            Setting("251 nodes, 0.1 ms", thesis, 1e-4),
            Setting("501 nodes, 1 ms", Fingertip(nodes=501)),
        ]
        small = Fingertip(nodes=51)
        methods: tuple[Method, ...] = ("euler", "rk4")
        settings += [Setting(f"51 nodes, {method}", small, method=method) for method in methods]
    return settings


def chart_model(quick: bool, progress: Callable[[str], None]) -> Chart:
    """Measure chains and steps; a quick run has fewer turns and a coarser truth.

    Errors are the largest of three objects at four instants, against a finer chain in finer steps.
    """
    nodes, step = (501, 1e-3) if quick else (1001, 1e-4)
    fine = Setting("truth", Fingertip(nodes=nodes), step)
    truth = []
    for obj in _OBJECTS:
        progress(f"{nodes} nodes in steps of {1e3 * step:g} ms, {obj.stiffness:g} N/m")
        truth.append(margins(fine.tip, obj, fine.run(obj)))
    settings = _settings(quick)
    points = [
        Point(
            name=setting.name,
            times=[],
            errors={},
            ours=setting.method == "implicit",
            settings=f"{setting.tip.law} chain, {setting.method}",
            command="chromagrip chart model",
        )
        for setting in settings
    ]
    for turn in range(2 if quick else 4):  # the first compiles
        for setting, point in zip(settings, points, strict=True):
            once = setting.method != "implicit"  # takes minutes, and is far from the front
            if turn and once:
                continue
            progress(f"{setting.name}, turn {turn + 1}")
            begin = time.process_time()
            runs = [setting.run(obj) for obj in _OBJECTS]
            spent = 1e3 * (time.process_time() - begin) / (DURATION * len(_OBJECTS))
            if turn or once:
                point.times.append(spent)
            if not turn:
                point.errors.update(_errors(setting, runs, truth))
    title = f"Node models: a grasp of {_GRIP:g} N, against {nodes} nodes in {1e3 * step:g} ms steps"
    return Chart(part="model", title=title, per="simulated second", points=points, axes=AXES)


def _errors(setting: Setting, runs: list[History], truth: list[Array]) -> dict[str, float]:
    normal, margin = 0.0, 0.0
    for obj, run, true in zip(_OBJECTS, runs, truth, strict=True):
        coarse = margins(setting.tip, obj, run)
        normal = max(normal, float(abs(coarse[:, 0] / true[:, 0] - 1.0).max()))
        margin = max(margin, float(np.nanmax(abs(coarse[:, 1] - true[:, 1]))))
    return {"normal_error": 100.0 * normal, "margin_error": margin}
