"""The domes that were built grasp through the camera, with a read-out of their own."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from chromagrip.calibrate.first_use import EPOCHS, HISTORIES, NOISE
from chromagrip.calibrate.readout import train
from chromagrip.loop.grasp import grasp
from chromagrip.loop.run import run
from chromagrip.scene.scene import Scene, load_scene
from chromagrip.sensing.reader import known_sensor
from chromagrip.sensing.sensor import open_camera
from chromagrip.tracking import sensor_as_designed

#: Grasps that differ, and the frames that are read of each: before and after a rise of the load.
GRASPS, READ = 40, (14, 29)


def any_scene(name: str, seed: int) -> Scene:
    """A constant grip with a load that does not let the object slide."""
    rng = np.random.default_rng([5, seed])
    grip, kpa = np.exp(rng.uniform(np.log([2.0, 100.0]), np.log([8.0, 1000.0])))
    friction, share = rng.uniform([0.3, 0.05], [0.9, 0.8])
    changes = {
        "sensor": name,
        "seed": seed,
        "controller": "conservative",
        "conservative.force_n": float(grip),
        "duration_s": 0.5,
        "object.friction": float(friction),
        "object.stiffness_kpa": float(kpa),
        "object.radius_mm": float(rng.choice([np.inf, 60.0, 30.0])),
        "load.times_s": [0.04, 0.25],
        "load.forces_n": [float(part * share * friction * grip) for part in (0.5, 1.0)],
    }
    return load_scene("margin-60hz", changes)


def held_by_one_answer(margins: np.ndarray, width: float) -> float:
    """Largest share of true margins that an interval holds which is always the same."""
    return max(float(np.mean((low <= margins) & (margins <= low + width))) for low in margins)


# The training is the one that a first grasp begins. With one of 750 histories and 12 passes, which
# was here before, the networks know little: ΣFn of dome-2022 is read to 8 %, but with a stated
# deviation of 34 %, and from 40 % on a frame is refused. On dome-2020, where some five pairs move
# in a contact, it was 40 %: a little more or less refused all frames, or told intervals of Γ that
# hold any value, so that an answer that is always the same passed.
# Of histories that the training has not seen, nine in ten lie within their interval of Γ, but only
# three in four where it is narrow, as it is of these plain grasps.
@pytest.mark.loops
@pytest.mark.parametrize("name", ["dome-2020", "dome-2022"])
def test_intervals_of_a_built_dome_hold_the_truth_and_tell_grasps_apart(
    name: str, tmp_path: Path
) -> None:
    file = tmp_path / "readout.npz"
    train(sensor_as_designed(name), NOISE, HISTORIES, EPOCHS, file, 2, lambda text: None)
    told = []
    for seed in range(GRASPS):
        scene = any_scene(name, seed)
        known = dataclasses.replace(known_sensor(scene), readout=file)
        for sample in grasp(scene, open_camera(scene), known=known):
            margin = sample.field.safety_margin(sample.friction)
            if sample.index in READ and not sample.observation.no_estimate:
                told.append([margin, *sample.observation.margin_interval])
    assert len(told) > 0.6 * GRASPS * len(READ)
    margin, low, high = np.array(told).T
    inside = np.mean((low <= margin) & (margin <= high))
    assert inside > 0.65
    assert inside > held_by_one_answer(margin, float(np.median(high - low))) + 0.1


def test_the_truth_path_holds_with_a_built_dome(tmp_path: Path) -> None:
    changes = {"sensor": "dome-2020", "path": "truth", "duration_s": 0.6}
    summary = run(load_scene("margin-60hz", changes), tmp_path / "run").summary
    assert not summary["gross_slip"]
    assert summary["mechanics"] == "chain"
