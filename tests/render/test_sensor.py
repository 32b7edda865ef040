"""Sensor designs: what is shipped, one's own, and what is refused in a sentence."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from chromagrip.errors import UserError
from chromagrip.render import FisheyeCamera, load_sensor, save_camera

DESIGNS = Path(__file__).parents[2] / "render" / "designs"
DOME, FLAT = "thesis", "flat-2019"


def changed(tmp_path: Path, changes: dict[str, Any], base: str = DOME) -> str:
    """File of a shipped design with some values changed; None takes a key away."""
    values = tomllib.loads((DESIGNS / f"{base}.toml").read_text(encoding="utf-8"))
    for key, value in changes.items():
        table, _, name = key.rpartition(".")
        place = values[table] if table else values
        if value is None:
            del place[name]
        else:
            place[name] = value
    path = tmp_path / "own.toml"
    path.write_text(tomli_w.dumps(values), encoding="utf-8")
    return str(path)


def test_designs_have_the_published_sizes_and_numbers_of_markers() -> None:
    for name, count, radius in ((DOME, 400, 8e-3), ("dome-2020-printed", 77, 20e-3),
                                ("dome-2022", 400, 21e-3)):  # fmt: skip
        sensor = load_sensor(name)
        assert len(sensor.places) == count
        assert sensor.shape.radius == pytest.approx(radius)
        assert not sensor.shape.flat
    sensor = load_sensor(FLAT)  # ten by ten squares of 2 mm, 3 mm apart
    points = sensor.shape.points(sensor.places, 0.0)
    assert sensor.shape.flat
    assert (sensor.markers.form, points.shape) == ("square", (100, 3))
    np.testing.assert_allclose(np.unique(points[:, 0].round(9)), 3e-3 * (np.arange(10) - 4.5))
    np.testing.assert_allclose(2 * sensor.half_sizes, 2e-3)


def test_thesis_is_frozen() -> None:
    """Another number is another design: what was measured on this one must stay comparable."""
    sensor = load_sensor(DOME)
    assert (sensor.view.width, sensor.view.height) == (640, 480)
    np.testing.assert_allclose(sensor.depths, [0.3e-3, 1.0e-3])
    np.testing.assert_allclose(sensor.half_sizes, 0.25e-3)
    np.testing.assert_allclose(sensor.follow, [1.0, 0.5])
    assert isinstance(sensor.view.camera, FisheyeCamera)
    assert sensor.view.camera.focal == (152.8, 152.8)
    assert sensor.markers.stretch == sensor.markers.swell_mm == 0.0
    # 19.1 px/mm on the skin, as the facts about it say.
    gain = sensor.view.jacobian(np.array([1e-9, 0.0, 8e-3]))[0, 0] * 1e-3
    assert gain == pytest.approx(19.1, abs=0.01)


def test_layouts_of_rings_and_from_a_file(tmp_path: Path) -> None:
    ring = {"kind": "ring", "counts": [1, 4, 8, 12, 16, 16, 20], "pitch_mm": 3.9}
    assert len(load_sensor(changed(tmp_path, {"layout": ring}, "dome-2020-printed")).places) == 77
    (tmp_path / "places.csv").write_text("theta_deg,phi_deg\n0,0\n20,30\n40,200\n")
    listed = load_sensor(changed(tmp_path, {"layout": {"kind": "file", "path": "places.csv"}}))
    np.testing.assert_allclose(np.rad2deg(listed.places[1:]), [[20, 30], [40, 200]])


def test_camera_from_a_calibration_file_whose_model_may_be_open(tmp_path: Path) -> None:
    lens = (0.01, 0.0, 0.0, 0.0)
    camera = FisheyeCamera(
        width=640, height=480, focal=(151.0, 151.6), centre=(321.0, 238.0), distortion=lens
    )
    save_camera(camera, tmp_path / "camera.yml")
    own = {"camera.calibration": "camera.yml", "camera.focal_px": None, "layout.coverage_deg": 70.0}
    assert load_sensor(changed(tmp_path, own)).view.camera == camera
    with pytest.raises(UserError, match=r"is for 640×480 images, these are 800×600"):
        load_sensor(changed(tmp_path, own | {"camera.width_px": 800, "camera.height_px": 600}))
    matrix = np.array([[151.0, 0, 321.0], [0, 151.6, 238.0], [0, 0, 1]])
    np.savez(tmp_path / "lens.npz", mtx=matrix, dist=lens)  # the design has the size
    own["camera.calibration"] = "lens.npz"
    assert load_sensor(changed(tmp_path, own)).view.camera == camera
    with pytest.raises(UserError, match=r"does not say whether .* give model in \[camera\]"):
        load_sensor(changed(tmp_path, own | {"camera.model": None}))


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    (DOME, {"magenta.size_mm": 2.0}, r"magenta markers \d+ and \d+ overlap: .* mm apart, 2 mm in"),
    (DOME, {"camera.focal_px": [400.0, 400.0]}, r"\d+ of 400 magenta.*outside the 640×480"),
    (DOME, {"camera.position_mm": 7.0}, r"position_mm = 7 must be within ±6, the hollow"),
    (FLAT, {"camera.position_mm": -7.0}, r"position_mm = -7 must be below -8, the base of the pad"),
    (DOME, {"skin.hollow_mm": 9.0}, "hollow_mm must be less than skin.radius_mm"),
    (DOME, {"yellow.depth_mm": 3.0}, "yellow.depth_mm = 3.0 must be less than the silicone's 2"),
    (DOME, {"magenta.follow": 0.0}, "magenta.follow = 0 must be above 0"),
    (
        DOME,
        {"layout": {"kind": "grid", "rows": 60, "columns": 2, "pitch_mm": 1.0}},
        "lie off the skin",
    ),
    (FLAT, {"layout": {"kind": "spiral", "count": 9, "coverage_deg": 50.0}}, "need a dome"),
]


def test_what_cannot_be_is_refused_in_a_sentence(tmp_path: Path) -> None:
    for base, changes, words in REFUSED:
        with pytest.raises(UserError, match=words) as caught:
            load_sensor(changed(tmp_path, changes, base))
        assert "\n" not in str(caught.value)
    with pytest.raises(UserError, match="no sensor design 'gelsight'; there is chromatouch-next"):
        load_sensor("gelsight")
