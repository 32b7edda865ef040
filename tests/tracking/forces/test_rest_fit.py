import numpy as np
import pytest
from msgspec.structs import replace

from chromagrip.render import Defects, Flaws, SensorDesign, load_sensor, open_renderer
from chromagrip.render.flaws.noise import add_noise
from chromagrip.render.frame import Frame
from chromagrip.render.membrane import rest_membrane
from chromagrip.tracking import MarkerTracker, Palette, Tracks
from chromagrip.tracking.forces.rest_fit import fitted_to_rest

SENSOR = load_sensor("thesis")


def with_camera(x: float, y: float, focal: float) -> SensorDesign:
    camera = replace(
        SENSOR.camera, focal_px=(152.8 * focal, 152.8 * focal), centre_px=(319.5 + x, 239.5 + y)
    )
    return replace(SENSOR, camera=camera)


def resting(true: SensorDesign, defects: Defects) -> Tracks:
    flaws = Flaws(true, defects, 4)
    image = open_renderer("painter", true).render(flaws(rest_membrane(true, flaws.places)))
    frames = []
    for k in range(4):
        noisy = image.copy()
        add_noise(noisy, 2.0, 1, k)
        frames.append(Frame(image=noisy, time=0.0))
    return MarkerTracker(Palette.of_sensor(SENSOR), 2.0).reset(frames)


@pytest.mark.parametrize("misaligned", [0.0, 0.15])
def test_the_camera_comes_out_of_the_resting_markers(misaligned: float) -> None:
    """Half a pixel and 0.4 %, and layers that lie beside each other do not pass for it."""
    true = with_camera(0.5, -0.3, 1.004)
    rest = resting(true, Defects(misplacement_mm=0.02, misalignment_mm=misaligned))
    found = fitted_to_rest(SENSOR, rest).camera
    # Markers that scatter by 0.4 px, and layers that may turn, leave a tenth.
    assert found.centre_px == pytest.approx((320.0, 239.2), abs=0.15)
    assert found.focal_px == pytest.approx((152.8 * 1.004,) * 2, rel=4e-4)


def test_a_camera_as_calibrated_stays() -> None:
    found = fitted_to_rest(SENSOR, resting(SENSOR, Defects())).camera
    assert found.centre_px == pytest.approx((319.5, 239.5), abs=0.02)
    assert found.focal_px == pytest.approx((152.8, 152.8), rel=1e-4)


def test_markers_of_another_layout_say_nothing_of_the_camera() -> None:
    rest = resting(SENSOR, Defects())
    rng = np.random.default_rng(0)
    thrown = rest.position + rng.uniform(-30.0, 30.0, rest.position.shape)
    few = rest.visible & (rng.random(rest.visible.shape) < 0.1)
    other = Tracks(**{**vars(rest), "position": thrown, "visible": few})
    assert fitted_to_rest(SENSOR, other) is SENSOR
