"""Learn to grip with Gymnasium, from the markers that the tracker sees.

    python examples/learn_to_grip.py [GRASPS [FILE]]   # 40 in each of 6 rounds, policy.npz

A teacher knows the truth and says which grip would have the desired margin. The policy learns to
say the same from shifts and growths of the markers, grips by itself, and is taught where that leads
(DAgger: Ross, Gordon, Bagnell 2011). `compare_policy.py` compares it with the controllers.
"""

import math
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from scipy.signal import lfilter

from chromagrip.output.processes import map_processes
from chromagrip.thesis import DESIRED_MARGIN

Taken = tuple[np.ndarray, np.ndarray, np.ndarray]

ROUNDS = 6
LEAST, MOST = 0.5, 10.0  # grip [N]
SHAPES = 20  # principal components of the markers
MEMORY = (0.1, 1.0)  # time constants of what is remembered [s]
HIDDEN = 1000  # units, whose weights are drawn and stay
RIDGE = 1e-3
SLIDING, SURGE, WEIGHT = 0.05, 1.5, 5.0  # below this margin; of the grip and of the frame there
PERIOD = 0.01  # of frames [s]


class Policy(NamedTuple):
    """Linear maps from markers to shapes, to hidden units, and to the logarithm of the grip [N]."""

    shapes: np.ndarray
    scale: np.ndarray
    hidden: np.ndarray
    out: np.ndarray


def environment() -> gymnasium.Env:
    """Environment of a worker; a drop does not end a grasp, so that all last as long."""
    name = "chromagrip.gym:chromagrip/Grasp-v0"
    return gymnasium.make(name, observation="markers", most_n=MOST, dropped_mm=20.0)


def action(grip: float) -> np.ndarray:
    """Action of the environment that commands a grip [N]."""
    return np.array([2.0 * grip / MOST - 1.0])


def remembered(shapes: np.ndarray, grips: np.ndarray) -> np.ndarray:
    """Shapes and own grips of a grasp with their decaying averages, one row for each frame."""
    now = np.column_stack([shapes, np.log(grips)])
    decays = [math.exp(-PERIOD / constant) for constant in MEMORY]
    return np.hstack([now, *(lfilter([1.0 - a], [1.0, -a], now, axis=0) for a in decays)])


def units(policy: Policy, rows: np.ndarray) -> np.ndarray:
    """Hidden units, and the rows themselves."""
    scaled = np.column_stack([rows / policy.scale, np.ones(len(rows))])
    return np.hstack([np.tanh(scaled @ policy.hidden), scaled])


def decide(policy: Policy, shapes: list[np.ndarray], grips: list[float]) -> float:
    """Grip after the shapes that were seen and the grips that were commanded [N]."""
    row = remembered(np.array(shapes), np.array(grips))[-1:]
    return min(max(math.exp((units(policy, row) @ policy.out).item()), LEAST), MOST)


def taught(info: dict[str, Any]) -> tuple[float, float]:
    """Grip that would have the desired margin, or more on a slide [N]; weight of the frame."""
    margin = info.get("margin_true", np.nan)  # none without contact
    surge, weight = (SURGE, WEIGHT) if margin < SLIDING else (1.0, 1.0)
    needed = info["applied_n"] * (1.0 - margin) / (1.0 - DESIRED_MARGIN) * surge
    return (min(max(needed, LEAST), MOST) if math.isfinite(needed) else LEAST), weight


def drawn(rng: np.random.Generator) -> dict[str, Any]:
    """Changes of the scene to an object and a load; every fourth object is flat."""
    return {
        "duration_s": 1.5,
        "object.friction": math.exp(rng.uniform(math.log(0.22), math.log(0.9))),
        "object.stiffness_kpa": math.exp(rng.uniform(math.log(12.0), math.log(300.0))),
        "object.radius_mm": math.inf if rng.random() < 0.25 else 1.0 / rng.uniform(1 / 40, 1 / 4),
        "load.times_s": [0.04, rng.uniform(0.4, 1.1)],
        "load.forces_n": rng.uniform([0.1, 0.1], [0.5, 1.0]),
    }


def wandering(rng: np.random.Generator, deviation: float, constant: float) -> Iterator[float]:
    """Factors whose logarithms have that deviation and time constant [s], frame by frame."""
    decay, value = math.exp(-PERIOD / constant), deviation * rng.standard_normal()
    while True:
        yield math.exp(value)
        value = decay * value + deviation * math.sqrt(1.0 - decay**2) * rng.standard_normal()


def practise(task: tuple[Sequence[int], Policy | None]) -> list[Taken]:
    """Of each drawn grasp: markers, own grips before, and what was taught in each frame.

    Without a policy the grip is the teacher's for a guessed µ, so that it tells nothing of the
    true one. A policy grips with noise in every other grasp.
    """
    seeds, policy = task
    env, taken = environment(), []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        changes = drawn(rng)
        guess = changes["object.friction"] / rng.uniform(0.2, 0.9)
        noise = wandering(rng, 0.15 * (seed % 2) if policy else 0.4, rng.uniform(0.03, 0.3))
        markers, shapes, grips, lessons, over = [], [], [LEAST], [], False
        seen, info = env.reset(seed=seed, options={"changes": changes})
        while not over:
            markers.append(seen)
            lessons.append(taught(info))
            grip = guess * lessons[-1][0]
            if policy:
                shapes.append(seen @ policy.shapes)
                grip = decide(policy, shapes, grips)
            grips.append(min(max(grip * next(noise), 0.1), MOST))
            seen, _, terminated, truncated, info = env.step(action(grips[-1]))
            over = terminated or truncated
        taken.append((np.array(markers), np.array(grips[:-1]), np.array(lessons)))
    return taken


def beginning(taken: list[Taken], rng: np.random.Generator) -> Policy:
    """Policy that has learnt nothing, with the shapes of the first grasps."""
    markers = np.vstack([seen for seen, _, _ in taken])
    shapes = np.linalg.svd(markers[::10], full_matrices=False)[2][:SHAPES].T
    rows = np.vstack([remembered(seen @ shapes, grips) for seen, grips, _ in taken])
    width = rows.shape[1] + 1
    hidden = rng.standard_normal((width, HIDDEN)) / math.sqrt(width)
    return Policy(shapes, rows.std(axis=0), hidden, np.zeros(HIDDEN + width))


def learn(grasps: int, rng: np.random.Generator) -> Policy:
    """Policy after all rounds, each fitted to everything that was taught so far."""
    policy, gram, moment, count = None, 0.0, 0.0, 0
    for number in range(ROUNDS):
        seeds = range(number * grasps, (number + 1) * grasps)
        halves = map_processes(practise, [(seeds[k::2], policy) for k in (0, 1)], 2, ordered=True)
        taken = [one for pair in zip(*halves, strict=True) for one in pair]
        policy = policy or beginning(taken, rng)
        for seen, grips, lessons in taken:
            values = units(policy, remembered(seen @ policy.shapes, grips))
            teacher, weights = lessons.T
            gram = gram + (values.T * weights) @ values
            moment, count = moment + (values.T * weights) @ np.log(teacher), count + weights.sum()
        ridge = RIDGE * count * np.eye(len(gram))
        policy = policy._replace(out=np.linalg.solve(gram + ridge, moment))
    return policy


def main(grasps: str = "40", file: str = "policy.npz") -> None:
    begun = time.monotonic()
    policy = learn(int(grasps), np.random.default_rng(0))
    np.savez(file, **policy._asdict())
    print(f"{file}: learnt in {time.monotonic() - begun:.0f} s")


if __name__ == "__main__":
    main(*sys.argv[1:])
