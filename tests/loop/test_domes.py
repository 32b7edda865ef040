"""The domes that were built grasp through the camera, with a read-out of their own."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from chromagrip.calibrate.readout import train
from chromagrip.loop.grasp import grasp
from chromagrip.loop.run import run
from chromagrip.scene.scene import load_scene
from chromagrip.sensing.reader import known_sensor
from chromagrip.sensing.sensor import open_camera
from chromagrip.tracking import sensor_as_designed

#: A training of two minutes: intervals are asked of it, not sharp ones.
HISTORIES, EPOCHS, NOISE = 750, 12, 2.0
#: A grip that is raised and a load, of which the sensor shows something.
CHANGES = {"controller": "conservative", "conservative.force_n": 6.0, "duration_s": 0.8}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dome-2020", "dome-2022"])
def test_a_built_dome_holds_and_its_intervals_hold_the_truth(name: str, tmp_path: Path) -> None:
    file = tmp_path / "readout.npz"
    train(sensor_as_designed(name), NOISE, HISTORIES, EPOCHS, file, 2, lambda text: None)
    inside, told = 0, 0
    for seed in range(3):
        scene = load_scene("margin-60hz", {**CHANGES, "sensor": name, "seed": seed})
        known = dataclasses.replace(known_sensor(scene), readout=file)
        for sample in grasp(scene, open_camera(scene), known=known):
            low, high = sample.observation.margin_interval
            margin = sample.field.safety_margin(sample.friction)
            if np.isfinite([low, high, margin]).all():
                told += 1
                inside += low <= margin <= high
    assert told > 20
    assert inside > 0.85 * told


def test_the_truth_path_holds_with_a_built_dome(tmp_path: Path) -> None:
    changes = {"sensor": "dome-2020", "path": "truth", "duration_s": 0.6}
    summary = run(load_scene("margin-60hz", changes), tmp_path / "run").summary
    assert not summary["gross_slip"]
    assert summary["mechanics"] == "chain"
