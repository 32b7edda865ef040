"""Scenes of the world `dome`, and what estimators read in them, in one process for each core."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....by_name import Choice
from ...study import Results
from .across import DESIGN, WORLDS, across_scene
from .elements import pressed_scene
from .readings import Reading, read
from .scenes import CALIBRATED, NOMINAL, SETS, TURNED, Watched, scene

Array = NDArray[np.float64]

#: Designs that `contact` reads, and a set of theirs that finite elements draw.
DESIGNS, ELEMENTS = ("dome-2020", "dome-2022"), "elements"
#: Design of two soft layers whose mismatched specimens are read too, and its share of the scenes.
NEXT, _FEWER = "chromatouch-next", 4
#: Names of the sets that all estimators read in all worlds, and of the one of their design that
#: BEST reads.
ACROSS, SOFT = "across", "soft"
#: Groups that can be asked for.
DOME_GROUPS = (*SETS, ELEMENTS, ACROSS)
#: Scenes of each group, of each design or world, and of a quick run of one design.
COUNTS = {
    "matched": 40,
    "light": 8,
    CALIBRATED: 16,
    NOMINAL: 8,
    TURNED: 4,
    "unlike": 10,
    ELEMENTS: 4,
    ACROSS: 6,
    SOFT: 16,
}
QUICK = {"matched": 2, ELEMENTS: 1}
#: Estimators of the chain and of domes.
CHAIN, BEST = "sequential", "contact"
#: Those that read the sets of all worlds.
COMPARED = (CHAIN, BEST)


@dataclass(frozen=True, kw_only=True)
class DomeTask:
    """One scene to make, and the estimators that read it.

    Attributes
    ----------
    design, kind: `kind` is of SETS or ELEMENTS; of the design DESIGN it is a world, or SOFT
    index: of the scene
    reconstructors: by name
    """

    design: str
    kind: str
    index: int
    reconstructors: Mapping[str, Choice]


@dataclass(frozen=True, kw_only=True)
class DomeResult:
    """Truth and readings of I frames.

    Attributes
    ----------
    true: (ΣFn [N], ΣFf [N], µ, Γ), shape (I, 4)
    side: ΣFf along x and y [N] and torque about z [N·m], shape (I, 3)
    readings: by estimator
    """

    true: Array
    side: Array
    readings: dict[str, Reading]


def counts_of(quick: bool, groups: Sequence[str]) -> dict[tuple[str, str], int]:
    """Number of scenes by design and set."""
    wanted = {g: n for g, n in (QUICK if quick else COUNTS).items() if not groups or g in groups}
    wanted |= {g: 1 for g in groups if g not in wanted}
    designs = DESIGNS[:1] if quick else DESIGNS
    other = (ACROSS, SOFT, TURNED)
    counts = {(d, g): n for g, n in wanted.items() if g not in other for d in designs}
    counts |= {(DESIGN, SOFT): wanted[SOFT]} if SOFT in wanted else {}
    counts |= {(NEXT, TURNED): wanted[TURNED]} if TURNED in wanted else {}
    if CALIBRATED in wanted and not quick:
        counts[NEXT, CALIBRATED] = wanted[CALIBRATED] // _FEWER
    return counts | {(DESIGN, world): wanted[ACROSS] for world in WORLDS if ACROSS in wanted}


def tasks(
    counts: Mapping[tuple[str, str], int],
    reconstructors: Mapping[str, Choice],
    beside: bool = False,
) -> list[DomeTask]:
    """Scenes of some sets.

    Parameters
    ----------
    counts: of scenes by design and set
    reconstructors: by name; none are those of `readers_of`
    beside: whether those are taken as well
    """
    return [
        DomeTask(
            design=design,
            kind=kind,
            index=index,
            reconstructors={**dict(zip(ours, ours, strict=True)), **reconstructors},
        )
        for (design, kind), count in counts.items()
        for ours in [readers_of(design, kind) if beside or not reconstructors else ()]
        for index in range(count)
    ]


def by_set(results: Results[DomeTask, DomeResult]) -> dict[tuple[str, str], DomeResult]:
    """Results of the scenes of each set, by design and set."""
    parts: dict[tuple[str, str], list[DomeResult]] = {}
    for task, result in results:
        parts.setdefault((task.design, task.kind), []).append(result)
    return {key: joined(found) for key, found in parts.items()}


def readers_of(design: str, kind: str) -> tuple[str, ...]:
    """Estimators that read a set of a design where none are asked for."""
    return COMPARED if design == DESIGN and kind != SOFT else (BEST,)


def measure_scene(task: DomeTask) -> DomeResult:
    """Make a scene and let every estimator read it."""
    watched = _scene(task)
    return DomeResult(
        true=watched.true,
        side=watched.side,
        readings={name: read(choice, watched) for name, choice in task.reconstructors.items()},
    )


def _scene(task: DomeTask) -> Watched:
    if task.design == DESIGN and task.kind in WORLDS:
        return across_scene(task.kind, task.index)
    if task.kind == ELEMENTS:
        return pressed_scene(task.design, task.index)
    return scene(task.design, task.kind, task.index)


def joined(parts: Sequence[DomeResult]) -> DomeResult:
    """The frames of several scenes."""
    return DomeResult(
        true=np.concatenate([part.true for part in parts]),
        side=np.concatenate([part.side for part in parts]),
        readings={
            name: Reading.joined([part.readings[name] for part in parts])
            for name in parts[0].readings
        },
    )
