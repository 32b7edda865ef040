"""Runs of a sweep: what is varied, the scene of each run, and what came of it."""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from ...errors import UserError
from ...loop.run import ANSWER_WITHIN_S, run
from ...scene.scene import Scene, load_scene
from ..worlds.pinch_scores import pinch_scores
from ..worlds.scorecard import scores

#: Values that one key takes, or one name, such as `controller`.
Axis = tuple[str, tuple[Any, ...]]
#: Most runs of a sweep.
MOST_RUNS = 100_000


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a sweep varies.

    Attributes
    ----------
    scenes: names or files
    axes: keys of a scene with their values, each by its dotted name
    seeds: number of seeds; they count from the scene's own
    fixed: changes that all runs share
    answer_within_s: time in which a controller that is not ours must answer
    allow: modules that a scene's file may name, see `load_scene`
    """

    scenes: tuple[str, ...]
    axes: tuple[Axis, ...] = ()
    seeds: int = 1
    fixed: Mapping[str, Any]
    answer_within_s: float = ANSWER_WITHIN_S
    allow: tuple[str, ...] = ()

    def settings(self) -> list[dict[str, Any]]:
        """Every combination of values; the last axis changes fastest."""
        names = [name for name, _ in self.axes]
        values = itertools.product(*(values for _, values in self.axes))
        return [dict(zip(names, combination, strict=True)) for combination in values]


@dataclass(frozen=True, kw_only=True)
class SweepRun:
    """One run that is to be made.

    Attributes
    ----------
    scene: with all changes
    name: of the scene
    setting: what is varied, in words
    answer_within_s: as of the plan
    """

    scene: Scene
    name: str
    setting: str
    answer_within_s: float


@dataclass(frozen=True, kw_only=True)
class SweepCell:
    """What came of one run.

    The scores are those of `scorecard`, of two fingers those of `pinches.scores`. They are NaN of
    a run that failed, and where there is none. `settling` is infinite where Γ never settled.

    Attributes
    ----------
    scene, setting, seed: of the run
    failed: why it did not come to its end; empty when it did
    """

    scene: str
    setting: str
    seed: int
    failed: str = ""
    gross: float = math.nan
    displacement: float = math.nan
    overloaded: float = math.nan
    settling: float = math.nan
    overshoot: float = math.nan
    pressure_max: float = math.nan
    pressure_mean: float = math.nan
    energy: float = math.nan
    chatter: float = math.nan
    turn: float = math.nan

    @property
    def lost(self) -> bool:
        """Whether the object was lost: it slipped or fell, or the run did not come to its end."""
        return bool(self.failed) or self.gross > 0.0


#: Names of the scores of a cell.
SCORES = tuple(field.name for field in fields(SweepCell))[4:]


def words(setting: Mapping[str, Any]) -> str:
    """A setting in words; empty where nothing is varied."""
    return " ".join(f"{key}={value}" for key, value in setting.items())


def tasks(plan: Plan) -> list[SweepRun]:
    """Every run of a plan, in order.

    Raises
    ------
    UserError
        For a scene, a key or a value that is not allowed, and for too many runs.
    """
    settings = plan.settings()
    count = len(settings) * len(plan.scenes) * plan.seeds
    if count > MOST_RUNS:
        raise UserError(f"a sweep of {count} runs is too long; at most {MOST_RUNS} are allowed")
    made: list[SweepRun] = []
    counts: set[int] = set()
    for setting in settings:
        for name in plan.scenes:
            first = load_scene(name, {**plan.fixed, **setting}, allow=plan.allow)
            counts.add(first.fingers)
            for seed in range(first.seed, first.seed + plan.seeds):
                scene = load_scene(name, {**plan.fixed, **setting, "seed": seed}, allow=plan.allow)
                made.append(
                    SweepRun(
                        scene=scene,
                        name=name,
                        setting=words(setting),
                        answer_within_s=plan.answer_within_s,
                    )
                )
    if len(counts) > 1:
        raise UserError("scenes of one finger and of two have other scores; sweep them apart")
    return made


def end_of(scene: Scene) -> float:
    """Time from the last change of load or friction to the last frame [s]."""
    return (scene.frames - 1) * scene.period - scene.last_change - 1e-6


def cell(task: SweepRun) -> SweepCell:
    """Make one run."""
    found: dict[str, float] = {}
    failed = ""
    try:
        result = run(task.scene, answer_within_s=task.answer_within_s)
        found = {1: scores, 2: pinch_scores}[task.scene.fingers](result)
        if found.get("settling", 0.0) >= end_of(task.scene) > 0.0:
            found["settling"] = math.inf
    except UserError as error:
        failed = str(error)
    return SweepCell(
        scene=task.name,
        setting=task.setting,
        seed=task.scene.seed,
        failed=failed,
        **found,
    )
