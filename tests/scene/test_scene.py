import math
from pathlib import Path
from typing import Any

import pytest

from chromagrip import UserError, load_scene, scene_names
from chromagrip.scene.scene import dump_scene, parse_change


def test_a_scene_survives_its_own_file(tmp_path: Path) -> None:
    for name in scene_names():
        scene = load_scene(name)
        file = tmp_path / "again.toml"
        file.write_text(dump_scene(scene), encoding="utf-8")
        assert load_scene(str(file)) == scene


def test_scenes_of_the_thesis_object() -> None:
    for name in ("camera-100hz", "margin-30hz", "margin-60hz", "thesis"):
        scene = load_scene(name)
        obj = scene.build_object()
        assert (obj.friction, obj.stiffness, obj.curvature) == (0.5, 1000.0, 0.0)
        assert [scene.load.force(t) for t in (0.0, 0.039, 0.04, 0.99, 1.0, 1.99)] == [
            0.0, 0.0, 0.25, 0.25, 0.65, 0.65,
        ]  # fmt: skip
    fast, slow = load_scene("thesis"), load_scene("camera-100hz")
    assert (fast.frames, fast.camera.latency_frames) == (2001, 0)
    assert (slow.frames, slow.camera.latency_frames) == (201, 1)
    assert (fast.safety_margin.proportional_n, fast.safety_margin.integral_n_per_s) == (2.5, 100)
    assert (slow.safety_margin.proportional_n, slow.safety_margin.integral_n_per_s) == (0.25, 30)
    for rate in (30, 60):
        camera = load_scene(f"margin-{rate}hz").camera
        assert (camera.rate_hz, camera.latency_frames) == (rate, 1)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("object.foo", 1, "unknown key object.foo; allowed here: stiffness_kpa, friction"),
        ("speed", 1, r"unknown key speed .did you mean seed\?.; allowed here: description"),
        ("object.stiffness_kpa", -3, "object.stiffness_kpa = -3: expected a number > 0.0"),
        ("object.friction", math.nan, "object.friction = nan"),
        ("camera.latency_frames", 1.5, "expected a whole number"),
        ("controller", "pid", "there is safety-margin, .*, conservative, or give module:Class"),
        ("camera.dropped", 1.0, "camera.dropped = 1.0: expected a number < 1.0"),
        ("camera.exposure_ms", 1.1, "camera.exposure_ms = 1.1 must be at most 1, the time between"),
        ("path", "both", "allowed: camera, truth"),
        ("load.times_s", [1.0, 0.5], "times_s must increase"),
        ("load.forces_n", [0.1, "x"], r"load.forces_n\[1\] = 'x'"),
        ("object.friction_times_s", [1.0], "friction_times_s has 1 entries and frictions 0"),
        ("object.friction_factors", [0.5], "friction_places_mm has 0 entries and friction_factors"),
        ("object.radius_mm", -0.5, "radius_mm = -0.5 must be at least 1, hollow at most -1"),
        ("object.radius_mm", 1e308, "no more than 1e9 unless it is inf"),
        ("object.radius_mm", -5.0, "is a hollow of 0.005 m radius, too narrow"),
        ("object.profile_mm", [[0.0, 0.0]], "profile must be at least 3 points"),
        ("fingertip.nodes", 250, "fingertip.nodes = 250 must be odd"),
        ("actuator.rate_n_per_s", 0.0, r"must be greater than 0 \(inf: unlimited\)"),
        ("sensor", "gelsight", "no sensor design 'gelsight'; there is .*thesis"),
    ],
)
def test_bad_values_are_named_with_what_is_allowed(key: str, value: Any, words: str) -> None:
    with pytest.raises(UserError, match=words) as caught:
        load_scene("thesis", {key: value})
    assert str(caught.value).startswith("scene thesis: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera.latency_frames": 201}, "latency_frames = 201 must be less than 201, the frames"),
        ({"fingertip.step_ms": 10.1}, "fingertip.step_ms = 10.1 must be at most 10, the time bet"),
        ({"camera.rate_hz": 1e-3}, r"rate_hz = 0.001 gives no second frame .*at least 0\.5"),
        (
            {"controller": "conservative", "conservative.force_n": 1e6},
            r"conservative.force_n = 1e\+06 must be at most 304, the grip that presses",
        ),
        (
            {"controller": "margin-inversion", "margin_inversion.ceiling_n": 305.0},
            "margin_inversion.ceiling_n = 305 must be at most 304",
        ),
        (
            {"controller": "react-to-slip", "react_to_slip.step_n": 82, "object.stiffness_kpa": 16},
            "react_to_slip.step_n = 82 must be at most 81.2",
        ),
        ({"safety_margin.feedforward_n": 400.0}, "safety_margin.feedforward_n = 400 must be at"),
        ({"held_margin": "friction"}, r"held_margin = 'friction' is for body = .dome."),
        ({"controller_arguments.gain": 2}, r"settings of safety-margin are in \[safety_margin\]"),
    ],
)
def test_values_that_do_not_fit_each_other_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError, match=words):
        load_scene("camera-100hz", changes)


def test_values_at_their_limits_are_allowed() -> None:
    changes = {"camera.latency_frames": 200, "fingertip.step_ms": 10, "conservative.force_n": 1e6}
    assert load_scene("camera-100hz", changes).frames == 201
    assert load_scene("camera-100hz", {"camera.rate_hz": 0.5, "duration_s": 2.0}).frames == 2


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    broken = tmp_path / "broken.toml"
    broken.write_text("duration_s = = 2", encoding="utf-8")
    with pytest.raises(UserError, match=r"is not valid TOML: .*line 1"):
        load_scene(str(broken))
    with pytest.raises(UserError, match="cannot be read: No such file"):
        load_scene(str(tmp_path / "none.toml"))
    with pytest.raises(UserError, match=r"there is camera-100hz, .*thesis, "):
        load_scene("strawberry")


def test_changes_are_toml_or_bare_words() -> None:
    assert parse_change("object.friction=0.3") == ("object.friction", 0.3)
    assert parse_change("load.times_s=[0.1, 1]") == ("load.times_s", [0.1, 1])
    assert parse_change("path=truth") == ("path", "truth")
    with pytest.raises(UserError, match="expected key=value"):
        parse_change("object.friction")
