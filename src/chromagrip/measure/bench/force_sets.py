"""Sets of grasps of each world, and what reconstructors read in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...by_name import Choice
from ...errors import UserError
from ...thesis import OBJECTS
from ...tracking import METHODS, load_reconstructor
from ..study import Asked, Results
from ..worlds.beyond.groups import BEYOND, beyond_scenes
from ..worlds.force_scenes import ForceScene
from ..worlds.force_scores import FOLLOWING, READ, Answers, answers, limits, refused, truth
from ..worlds.grasps import LIBRARY, scenes

Array = NDArray[np.float64]

#: Step from one object to the next. It has no divisor in common with 27: a few objects vary as all
#: do, and 27 steps reach all of them.
_STRIDE = 10


@dataclass(frozen=True, kw_only=True)
class GraspTask:
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
    answers: estimates of them by the frames that are read, and by reconstructor or reading
    limit: smallest standard deviations of them by the frames that are read, shape (S, 4)
    labels: of each scene
    """

    true: Array
    answers: dict[str, dict[str, Answers]]
    limit: dict[str, Array]
    labels: tuple[tuple[str, ...], ...] = ()


def set_name(world: str, kind: str) -> str:
    """Name of a set in rows."""
    if world == BEYOND:
        return f"{world}/{kind}"
    return world if kind == LIBRARY else f"{world}-{kind}"


def choose(asked: Asked, usual: Sequence[Choice] = ()) -> dict[str, Choice]:
    """Reconstructors to compare by name; unless chosen these, or all of ours.

    Raises
    ------
    UserError
        When there is no such reconstructor.
    """
    return asked.chosen(usual or list(METHODS), load_reconstructor)


def tasks(
    counts: Mapping[tuple[str, str], int], reconstructors: Mapping[str, Choice], limited: int
) -> list[GraspTask]:
    """Grasps of some sets. Those of the world `beyond` are its groups.

    Parameters
    ----------
    counts: of grasps by world and kind
    reconstructors: by name
    limited: number of grasps of the matched library whose limits are computed, the first ones
    """
    return [
        GraspTask(
            world=world,
            kind=kind,
            index=k if kind == LIBRARY or world == BEYOND else k * _STRIDE % len(OBJECTS),
            reconstructors=reconstructors,
            limited=(world, kind) == ("matched", LIBRARY) and k < limited,
        )
        for (world, kind), count in counts.items()
        for k in range(count)
    ]


def by_set(results: Results[GraspTask, Measured]) -> dict[str, Measured]:
    """Results of the grasps of each set, by `set_name`."""
    sets: dict[str, list[Measured]] = {}
    for task, result in results:
        sets.setdefault(set_name(task.world, task.kind), []).append(result)
    return {name: joined(parts) for name, parts in sets.items()}


def joined(parts: Sequence[Measured]) -> Measured:
    """Results of several grasps together."""
    return Measured(
        true=np.concatenate([part.true for part in parts]),
        answers={
            read: {
                name: Answers.joined([part.answers[read][name] for part in parts])
                for name in parts[0].answers[read]
            }
            for read in READ
        },
        limit={read: np.concatenate([part.limit[read] for part in parts]) for read in READ},
        labels=tuple(labels for part in parts for labels in part.labels),
    )


def measure_grasp(task: GraspTask) -> Measured:
    """Make a grasp and let every reconstructor read it."""
    whole = FOLLOWING in task.reconstructors
    if task.world == BEYOND:
        made = beyond_scenes(task.kind, task.index, whole)
    else:
        made = scenes(task.world, task.kind, task.index, whole)
    return joined([_measure_scene(task, scene) for scene in made])


def _measure_scene(task: GraspTask, scene: ForceScene) -> Measured:
    estimates: dict[str, dict[str, Answers]] = {read: {} for read in READ}
    for name, choice in task.reconstructors.items():
        try:
            found = answers(name, choice, scene)
        except UserError:
            if task.world != BEYOND:
                raise
            # Rest frames that cannot be the sensor's are refused: every frame is flagged.
            found = refused(name)
        for read, estimate in found.items():
            estimates[read] |= estimate
    unknown = np.full(4, np.nan)
    return Measured(
        true=truth(scene)[None],
        answers=estimates,
        limit={
            read: (limits(scene, frames) if task.limited and read != "way" else unknown)[None]
            for read, frames in READ.items()
        },
        labels=(scene.labels,),
    )
