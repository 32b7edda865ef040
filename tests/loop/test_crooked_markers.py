"""A specimen of `dome-2020`, whose printed discs are crooked: what is seen of it stays seen."""

from contextlib import closing

from chromagrip.loop.camera import open_camera
from chromagrip.loop.grasp import grasp
from chromagrip.loop.observers import known_sensor
from chromagrip.scene.scene import load_scene
from chromagrip.tracking import MarkerTracker, Palette


def test_markers_that_are_seen_at_rest_and_no_others_are_seen_in_a_light_touch() -> None:
    changes = {"path": "camera", "sensor": "dome-2020", "duration_s": 0.12}
    scene = load_scene("dome-1", changes)
    with closing(open_camera(scene)) as camera:
        samples = grasp(scene, camera)
        rest = camera.expose_rest(next(samples).truth.state, 8)
        tracker = MarkerTracker(Palette.of_sensor(known_sensor(scene).sensor), 2.0)
        tracker.reset(rest)
        seen = tracker.rest.visible
        assert 0.8 * seen.size < seen.sum() < seen.size
        for sample in samples:
            assert sample.frame is not None
            assert (tracker.update(sample.frame).visible == seen).all()
