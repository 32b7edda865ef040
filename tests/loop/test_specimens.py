"""Specimens through the tracker: `chromatouch-next`, and `dome-2020` with its crooked discs."""

import math
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from chromagrip.loop.grasp import grasp
from chromagrip.model import Dome, Solid, press_and_move, simulate_contact
from chromagrip.model.dome import resting
from chromagrip.model.shapes import ball
from chromagrip.render import DomeMap, centroids, layer_depths, load_sensor, outlines
from chromagrip.scene.scene import load_scene
from chromagrip.sensing.reader import known_sensor
from chromagrip.sensing.sensor import TactileSensor, open_camera
from chromagrip.tracking import MarkerTracker, Palette
from chromagrip.tracking.fit import tracker as module

DESIGN = load_sensor("chromatouch-next")


def test_it_is_what_two_soft_layers_need() -> None:
    dome = DESIGN.dome
    assert isinstance(dome, Dome)
    assert 10e-3 <= dome.radius <= 12e-3
    shares = np.array(layer_depths(DESIGN, dome)) / dome.thickness
    assert 0.15 <= shares[0] <= 0.25
    assert 0.45 <= shares[1] <= 0.55
    assert len(DESIGN.places) == 400
    for depth in DESIGN.depths:
        points = DESIGN.shape.points(DESIGN.places, depth)
        assert np.sort(np.linalg.norm(points[:, None] - points, axis=-1), axis=1)[:, 1].max() < 1e-3
    # The resolution is that of the two ends of a millimetre on the skin.
    apart = 1e-3 / dome.radius
    for angle in (0.0, math.radians(50.0)):
        ends = DESIGN.shape.points(np.array([[angle, 0.0], [angle + apart, 0.0]]), 0.0)
        assert np.linalg.norm(np.diff(DESIGN.view.project(ends), axis=0)) >= 12.0


@pytest.mark.loops
def test_its_markers_are_followed_without_swaps() -> None:
    """A ball that is pressed to a third of the silicone, then sheared and twisted."""
    dome = replace(DESIGN.dome, pitch=0.8e-3)
    solid = Solid(shape=ball(8e-3), friction=0.8)
    motion = press_and_move(1e-3, shift=(0.5e-3, 0.3e-3), twist=math.radians(8.0))
    run = simulate_contact(dome, solid, motion, dt=10e-3, keep=10)
    states, carry = [resting(dome, solid, motion), *run.states], DomeMap(DESIGN, dome)
    sensor = TactileSensor(DESIGN, body=dome, noise=2.0, seed=3, membrane_map=carry)
    with closing(sensor.camera) as camera:
        tracker = MarkerTracker(Palette.of_sensor(DESIGN), 2.0)
        rest = tracker.reset(camera.expose_rest(states[0], 4))
        found = [tracker.update(camera.expose(state, k)) for k, state in enumerate(states)]
    true = np.stack(
        [centroids(outlines(carry(s.carried), DESIGN.view), square=False) for s in states]
    )
    nearest = [
        np.linalg.norm(rest.position[layer][:, None] - true[0, layer], axis=-1).argmin(axis=1)
        for layer in (0, 1)
    ]
    assert len(np.unique(nearest[0])) == 400
    assert (nearest[0] == nearest[1]).all()
    assert np.linalg.norm(true - true[0], axis=-1).max() > 12.0  # most of a pitch
    for tracks, truth in zip(found, true, strict=True):
        assert tracks.visible.all()
        error = tracks.position - truth[:, nearest[0]]
        assert abs(error).max() < 0.25
        assert np.sqrt((error**2).mean()) < 0.015


@pytest.mark.loops
def test_crooked_markers_stay_seen_and_colours_are_fitted_where_the_light_changes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In eight frames of a light touch, whose lamp changes at the sixth."""
    fits: list[Any] = []
    tune = module.tune
    monkeypatch.setattr(module, "tune", lambda *args: fits.append(args) or tune(*args))
    changes = {"path": "camera", "sensor": "dome-2020", "duration_s": 0.08}
    scene = load_scene("dome-1", changes)
    with closing(open_camera(scene)) as camera:
        samples = grasp(scene, camera)
        rest = camera.expose_rest(next(samples).contact.state, 8)
        frames = [sample.frame for sample in samples if sample.frame is not None]
    tracker = MarkerTracker(Palette.of_sensor(known_sensor(scene).sensor), 2.0)
    seen = tracker.reset(rest).visible
    assert 0.8 * seen.size < seen.sum() < seen.size
    for frame in frames[:5]:
        assert (tracker.update(frame).visible == seen).all()
    assert not fits  # they explain no less than at rest
    before = tracker.state
    clear = [tracker.update(frame) for frame in frames[5:]]
    tracker.state = before
    for frame, tracks in zip(frames[5:], clear, strict=True):
        image = np.rint(0.8 * frame.image + 40.0).astype(np.uint8)
        dim = tracker.update(replace(frame, image=image))
        assert (dim.visible == seen).all()
        off = (dim.position - tracks.position)[seen]
        assert np.sqrt((off**2).mean()) < 0.05
    assert fits
