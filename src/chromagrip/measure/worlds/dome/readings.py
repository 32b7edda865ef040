"""What an estimator reads in all frames of a scene, in order, and its scores.

A scene is read as a controller would: frame after frame from before the touch. What is scored are
the frames in which grip and load have been held. A frame that an estimator does not believe may
cost it seconds. Once it has taken too long over a scene, only the scored frames are given to it.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ....by_name import Choice
from ....errors import UserError
from ....output.processes import one_thread
from ....sensing.observers import ForceObserver
from ..beyond.scores import UNITS as OF_FRAMES
from ..beyond.scores import beyond_scores
from ..force_scores import OBSERVABLE, QUANTITIES, Answers, answer_of, average, rms
from ..force_scores import constant as constant_answers
from ..slowest import SLOWEST, slowest
from .scenes import Watched, side

Array = NDArray[np.float64]

#: Over which µ is averaged [s].
_WINDOW = 0.1
#: Processor time over a scene after which an estimator is given only the scored frames [s].
_PATIENCE = 15.0
#: Ranges of the true Γ in which its error is told apart.
NEAR = {"10": (0.0, 0.2), "30": (0.2, 0.45), "60": (0.45, 0.75)}
#: Unit of every score.
UNITS = {
    "normal_share": "%",
    "normal_bias": "%",
    "side_x": "N",
    "side_y": "N",
    "side_share": "%",
    "torque": "N·mm",
    "torque_share": "%",
    "mu_error": "",
    "mu_bias": "",
    **{f"margin_{near}": "" for near in NEAR},
    "margin_bias": "",
    **{f"{quantity}_coverage": "%" for quantity in QUANTITIES},
    **{f"{quantity}_width": "× RMS" for quantity in QUANTITIES},
    **{f"{quantity}_narrow": "%" for quantity in QUANTITIES},
    "honest": "%",
    "flagged": "%",
    "frames": "",
    "rate": "fields/s",
    **dict.fromkeys(SLOWEST, "ms"),
    "late": "%",
}


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What was read in I frames.

    Attributes
    ----------
    answers: of (ΣFn, ΣFf, µ, Γ)
    side: ΣFf along x and y [N] and torque about z [N·m], shape (I, 3)
    spent: processor time of a field in each scene, refusals included [s], shape (S,)
    each: processor time of every field [s], shape (F,)
    late: whether the estimator took too long over a scene, shape (S,)
    """

    answers: Answers
    side: Array
    spent: Array
    each: Array
    late: NDArray[np.bool_]

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """The frames of several scenes."""
        return cls(
            answers=Answers.joined([part.answers for part in parts]),
            side=np.concatenate([part.side for part in parts]),
            spent=np.concatenate([part.spent for part in parts]),
            each=np.concatenate([part.each for part in parts]),
            late=np.concatenate([part.late for part in parts]),
        )


def read(reconstructor: Choice, watched: Watched) -> Reading:
    """Read a scene by one estimator, in one thread."""
    count = len(watched.scored)
    try:
        observer = ForceObserver(watched.known, watched.rest, reconstructor, _WINDOW)
    except UserError:  # rest frames that cannot be the sensor's
        return _refused(count)
    found, sides, spent, whole = [], [], [], 0.0
    with one_thread():
        for k, tracks in enumerate(watched.tracks):
            if whole > _PATIENCE and k not in watched.scored:
                continue
            begin = time.process_time()
            observation = observer.observe(tracks.time, tracks)
            passed = time.process_time() - begin
            whole += passed
            if observation.field.contact.any() or observation.no_estimate:
                spent.append(passed)
            if k in watched.scored:
                found.append(answer_of(observation))
                sides.append(side(observation.field))
    mean = np.mean(spent) if spent else np.nan
    return Reading(
        answers=Answers.joined(found),
        side=np.array(sides),
        spent=np.array([mean]),
        each=np.array(spent),
        late=np.array([whole > _PATIENCE]),
    )


def constant(true: Array, side: Array) -> Reading:
    """The best answer without an image: mean and scatter of the truth, (I, 4) and (I, 3)."""
    return Reading(
        answers=constant_answers(true),
        side=np.broadcast_to(side.mean(axis=0), side.shape),
        spent=np.array([np.nan]),
        each=np.zeros(0),
        late=np.array([False]),
    )


def _refused(count: int) -> Reading:
    return Reading(
        answers=Answers(
            value=np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
            interval=np.full((count, 4, 2), np.nan),
            flagged=np.ones(count, dtype=np.bool_),
        ),
        side=np.zeros((count, 3)),
        spent=np.array([np.nan]),
        each=np.zeros(0),
        late=np.array([False]),
    )


def scores(reading: Reading, true: Array, side: Array) -> dict[str, float]:
    """Every score of UNITS; NaN where no frame has it. Errors are of frames that are not flagged.

    Parameters
    ----------
    reading: of I frames
    true: (ΣFn, ΣFf, µ, Γ) of each, shape (I, 4)
    side: ΣFf along x and y [N] and torque about z [N·m], shape (I, 3)
    """
    answers = reading.answers
    found = beyond_scores(answers, true)
    kept = ~answers.flagged
    error = (answers.value - true)[kept]
    across, turned = np.split((reading.side - side)[kept], [2], axis=1)
    (force, torque), loaded = np.split(side[kept], [2], axis=1), true[kept, 3] < OBSERVABLE
    found |= {
        "normal_share": found["normal_error"],
        "side_x": rms(across[:, 0]),
        "side_y": rms(across[:, 1]),
        "side_share": 100.0
        * rms(np.linalg.norm(across[loaded], axis=1))
        / max(rms(np.linalg.norm(force[loaded], axis=1)), 1e-12),
        "torque": 1e3 * rms(turned),
        "torque_share": 100.0 * rms(turned) / max(rms(torque), 1e-12),
        "frames": float(len(true)),
        "late": 100.0 * average(reading.late),
        "rate": 1.0 / float(np.nanmedian(reading.spent))
        if np.isfinite(reading.spent).any()
        else float("nan"),
    }
    found |= slowest(1e3 * reading.each)
    for name, (low, high) in NEAR.items():
        near = (true[kept, 3] >= low) & (true[kept, 3] < high)
        found[f"margin_{name}"] = rms(error[near, 3])
    assert found.keys() >= UNITS.keys() - OF_FRAMES.keys()
    return {name: found[name] for name in UNITS}
