"""Compare a policy of `learn_to_grip.py` with the controllers, on grasps through the camera.

    python examples/compare_policy.py [FILE [SEEDS [STEP]]]   # policy.npz, 2 for each object, 1

One table is for the 27 objects of the thesis, or every STEPth of them. The others are for what the
policy was not made for. An object that is pressed through counts as dropped; grip and Γ are over
the others.
"""

import math
import sys
from functools import partial
from typing import Any

import numpy as np
from learn_to_grip import LEAST, Policy, action, decide, environment

import chromagrip
from chromagrip.measure.score.intervals import intervals, share_interval
from chromagrip.output.processes import map_processes
from chromagrip.thesis import DESIRED_MARGIN, LOAD_TIMES_S, OBJECTS

Changes = dict[str, Any]
Scores = dict[str, float]

COLUMNS = ("time_s", "margin_true", "applied_n", "rigid_slip_mm")
CONTROLLERS: dict[str, Changes] = {
    "safety-margin": {},
    "margin-inversion": {"safety_margin.friction_window_s": 0.1},  # its average of µ
    "react-to-slip": {},
    "conservative": {"path": "truth"},  # which is the same for it, as it looks at nothing
}
BEYOND: dict[str, Changes] = {
    "another specimen: markers misplaced by 0.02 mm, 1 % missing": {
        "defects.misplacement_mm": 0.02,
        "defects.missing_markers": 0.01,
    },
    "noise of 6 grey levels": {"camera.noise_levels": 6.0},
    "µ 0.18": {"object.friction": 0.18},
    "radius 2.5 mm, 8 kPa": {"object.radius_mm": 2.5, "object.stiffness_kpa": 8.0},
    "load of 1.4 N": {"load.forces_n": [0.25, 1.4]},
}


def by_policy(policy: Policy, changes: Changes, seed: int) -> np.ndarray:
    """The columns of a grasp by the policy."""
    shapes, grips, truth, over = [], [LEAST], [], False
    with environment() as env:
        seen, _ = env.reset(seed=seed, options={"changes": changes})
        while not over:
            shapes.append(seen @ policy.shapes)
            grips.append(decide(policy, shapes, grips))
            seen, _, terminated, truncated, info = env.step(action(grips[-1]))
            truth.append([info[column] for column in COLUMNS])
            over = terminated or truncated
    return np.array(truth).T


def by_controller(name: str, changes: Changes, seed: int) -> np.ndarray:
    """The same by a controller."""
    changes = CONTROLLERS[name] | changes | {"controller": name, "seed": seed}
    trace = chromagrip.run(chromagrip.load_scene("camera-100hz", changes)).trace
    return np.array([trace[column] for column in COLUMNS])


def scores(columns: np.ndarray) -> Scores:
    """Of a grasp, over all frames under load; what is not touched has a margin of 0."""
    _, margin, applied, slid = columns[:, columns[0] >= LOAD_TIMES_S[0]]
    return {
        "slid": float(slid[-1] > 0.2),
        "dropped": float(slid[-1] > 1.0),
        "grip": float(applied.mean()),
        "square": float(((np.nan_to_num(margin) - DESIRED_MARGIN) ** 2).mean()),
    }


def compete(task: tuple[str, Policy, list[tuple[Changes, int]]]) -> list[Scores]:
    """Scores of grasps by the policy or a controller."""
    name, policy, grasps = task
    grip = partial(by_policy, policy) if name == "policy" else partial(by_controller, name)
    found = []
    for changes, seed in grasps:
        try:
            found.append(scores(grip(changes, seed)))
        except chromagrip.UserError:  # pressed through, which the model refuses
            found.append({"slid": 1.0, "dropped": 1.0})
    return found


def line(name: str, objects: list[list[Scores]]) -> str:
    """Line of a table; means are drawn again by object, as grasps of one object are alike."""
    runs = [run for of_object in objects for run in of_object]
    ended = [[run for run in some if "grip" in run] for some in objects]
    keys = ("grip", "square")
    means = [{key: np.mean([run[key] for run in some]) for key in keys} for some in ended if some]
    mean = {key: np.mean([one[key] for one in means]) if means else math.nan for key in keys}
    unknown = dict.fromkeys(mean, (math.nan, math.nan))  # of a single object
    bounds = unknown | intervals(means)
    cells = [name]
    for key in ("slid", "dropped"):
        hits = sum(run[key] for run in runs)
        low, high = share_interval(int(hits), len(runs))
        cells.append(f"{hits:.0f} of {len(runs)} [{low:.0%}, {high:.0%}]")
    low, high = bounds["grip"]
    cells.append(f"{mean['grip']:.2f} [{low:.2f}, {high:.2f}]")
    low, high = (math.sqrt(end) for end in bounds["square"])
    cells.append(f"{math.sqrt(mean['square']):.3f} [{low:.3f}, {high:.3f}]")
    return f"| {' | '.join(cells)} |"


def compare(policy: Policy, cases: list[Changes], seeds: int, names: list[str]) -> None:
    """Print a table: all cases, each with all seeds."""
    print("| | slid by 0.2 mm | dropped: by 1 mm | mean grip [N] | RMS of Γ − Γ_des |")
    print("|---|---|---|---|---|")
    halves = [[(case, seed) for case in cases[k::2] for seed in range(seeds)] for k in (0, 1)]
    for name in names:
        found = map_processes(compete, [(name, policy, half) for half in halves], 2, ordered=True)
        runs = [run for half in found for run in half]
        print(line(name, [runs[k : k + seeds] for k in range(0, len(runs), seeds)]), flush=True)


def main(file: str = "policy.npz", seeds: str = "2", step: str = "1") -> None:
    policy, some = Policy(**np.load(file)), OBJECTS[:: int(step)]
    objects = [{f"object.{key}": value for key, value in one._asdict().items()} for one in some]
    compare(policy, objects, int(seeds), ["policy", *CONTROLLERS])
    for name, changes in BEYOND.items():
        print(f"\n{name}\n")
        cases = [one | changes for one in objects if one["object.stiffness_kpa"] == 32.0]
        compare(policy, cases, 1, ["policy", "safety-margin", "margin-inversion"])


if __name__ == "__main__":
    main(*sys.argv[1:])
