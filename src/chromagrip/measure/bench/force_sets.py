"""Sets of grasps of each world, and what reconstructors read in them."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...by_name import Choice, named
from ...errors import UserError
from ...output.processes import map_processes
from ...thesis import OBJECTS
from ...tracking import METHODS, load_reconstructor
from ..beyond.groups import BEYOND, beyond_scenes
from ..worlds.force_scenes import ForceScene
from ..worlds.force_scores import READ, Answers, answers, limits, refused, truth
from ..worlds.grasps import LIBRARY, scenes

Array = NDArray[np.float64]

#: Step from one object to the next. It has no divisor in common with 27: a few objects vary as all
#: do, and 27 steps reach all of them.
_STRIDE = 10


@dataclass(frozen=True, kw_only=True)
class Task:
    """One grasp to make, and the reconstructors that read it.

    Attributes
    ----------
    world, kind, index: see `grasps.scenes`
    reconstructors: by name
    limited: whether its limits are computed
    """

    world: str
    kind: str
    index: int
    reconstructors: Mapping[str, Choice]
    limited: bool


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Results of the S scenes of one or more grasps.

    Attributes
    ----------
    true: (ΣFn [N], ΣFf [N], µ, Γ), shape (S, 4)
    answers: estimates of them by reconstructor or reading, and by the frames that are read
    limit: smallest standard deviations of them by the frames that are read, shape (S, 4)
    labels: of each scene
    """

    true: Array
    answers: dict[tuple[str, str], Answers]
    limit: dict[str, Array]
    labels: tuple[tuple[str, ...], ...] = ()


def set_name(world: str, kind: str) -> str:
    """Name of a set in rows."""
    if world == BEYOND:
        return f"{world}/{kind}"
    return world if kind == LIBRARY else f"{world}-{kind}"


def choose(reconstructors: Sequence[Choice]) -> dict[str, Choice]:
    """Reconstructors by name; none are all of ours.

    Raises
    ------
    UserError
        When there is no such reconstructor.
    """
    return named(reconstructors or list(METHODS), load_reconstructor)


def measure(
    counts: Mapping[tuple[str, str], int],
    reconstructors: Mapping[str, Choice],
    limited: int,
    progress: Callable[[str], None],
) -> dict[str, Measured]:
    """Let reconstructors read the grasps of some sets, in one process for each core.

    The sets of the world `beyond` are its groups: `measure({("beyond", "roll"): 24}, …)`.

    Parameters
    ----------
    counts: of grasps by world and kind
    reconstructors: by name
    limited: number of grasps of the matched library whose limits are computed, the first ones
    progress: called after each grasp

    Returns
    -------
    By `set_name`.
    """
    tasks = [
        Task(
            world=world,
            kind=kind,
            index=k if kind == LIBRARY or world == BEYOND else k * _STRIDE % len(OBJECTS),
            reconstructors=reconstructors,
            limited=(world, kind) == ("matched", LIBRARY) and k < limited,
        )
        for (world, kind), count in counts.items()
        for k in range(count)
    ]
    sets: dict[str, list[Measured]] = {}
    results = map_processes(measure_grasp, tasks, os.cpu_count() or 1, ordered=True)
    for done, (task, result) in enumerate(zip(tasks, results, strict=True), 1):
        name = set_name(task.world, task.kind)
        sets.setdefault(name, []).append(result)
        progress(f"{name}: grasp {done} of {len(tasks)}")
    return {name: _joined(parts) for name, parts in sets.items()}


def _joined(parts: Sequence[Measured]) -> Measured:
    return Measured(
        true=np.concatenate([part.true for part in parts]),
        answers={
            key: Answers.joined([part.answers[key] for part in parts]) for key in parts[0].answers
        },
        limit={read: np.concatenate([part.limit[read] for part in parts]) for read in READ},
        labels=tuple(labels for part in parts for labels in part.labels),
    )


def measure_grasp(task: Task) -> Measured:
    """Make a grasp and let every reconstructor read it."""
    if task.world == BEYOND:
        made = beyond_scenes(task.kind, task.index)
    else:
        made = scenes(task.world, task.kind, task.index)
    return _joined([_measure_scene(task, scene) for scene in made])


def _measure_scene(task: Task, scene: ForceScene) -> Measured:
    estimates: dict[tuple[str, str], Answers] = {}
    for name, choice in task.reconstructors.items():
        try:
            estimates |= answers(name, choice, scene)
        except UserError:
            if task.world != BEYOND:
                raise
            # Rest frames that cannot be the sensor's are refused: every frame is flagged.
            estimates |= refused(name)
    unknown = np.full(4, np.nan)
    return Measured(
        true=truth(scene)[None],
        answers=estimates,
        limit={
            read: (limits(scene, frames) if task.limited else unknown)[None]
            for read, frames in READ.items()
        },
        labels=(scene.labels,),
    )
