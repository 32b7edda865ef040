"""Where the design's image lies in a picture, from pixels of markers without a picture."""

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.render import SensorDesign, load_sensor
from chromagrip.tracking.forces import placement


def designed(sensor: SensorDesign) -> list[np.ndarray]:
    """Pixels of the resting markers of each layer in the design's image."""
    return [sensor.view.project(sensor.shape.points(sensor.places, d)) for d in sensor.depths]


def turned(pixels: np.ndarray, sensor: SensorDesign, roll: float, scale: float) -> np.ndarray:
    """Pixels turned about the optical axis and scaled about the first pixel."""
    lens, (cos, sin) = sensor.view.camera.lens, (np.cos(roll), np.sin(roll))
    axis = np.array([lens.centre_x, lens.centre_y])
    return scale * (axis + (pixels - axis) @ np.array([[cos, sin], [-sin, cos]]))


@pytest.mark.parametrize("name", ["thesis", "dome-2022", "dome-2020", "flat-2019"])
@pytest.mark.parametrize(
    ("scale", "roll", "corner", "size"),
    [
        (1.0, 0.0, (0.0, 0.0), (1.0, 1.0)),
        pytest.param(1.3, 0.0, (-90.3, 12.7), (0.8, 1.1), marks=pytest.mark.slow),
        pytest.param(2.2, 0.02, (250.0, 140.0), (1.5, 1.5), marks=pytest.mark.slow),
        (0.7, -0.02, (-60.0, -20.0), (0.8, 0.8)),
    ],
)
def test_scale_and_corner_come_back(
    name: str,
    scale: float,
    roll: float,
    corner: tuple[float, float],
    size: tuple[float, float],
) -> None:
    sensor, random = load_sensor(name), np.random.default_rng(5)
    view = sensor.view
    unit = scale * min(view.width, view.height) / 480
    moved = [unit / scale * c for c in corner]
    width, height = round(size[0] * scale * view.width), round(size[1] * scale * view.height)
    seen = []
    for pixels in designed(sensor):
        at = turned(pixels, sensor, roll, scale) + moved
        at = at[((at > 0.0) & (at < (width, height))).all(axis=-1)]
        at += random.normal(0.0, 0.1 * scale, at.shape)
        specks = random.uniform(0.0, (width, height), (len(at) // 20, 2))
        seen.append(np.concatenate([random.permutation(at), specks]))
    found = placement(sensor, seen, (width, height))
    assert found.scale == pytest.approx(scale, rel=3e-3)
    assert found.share > 0.9
    # On the axis it is more exact than at the corner, about which a wrong scale turns.
    np.testing.assert_allclose(found.corner, moved, atol=0.005 * scale * view.width)


@pytest.mark.slow
def test_markers_of_another_layout_have_no_place() -> None:
    sensor = load_sensor("thesis")
    random = np.random.default_rng(3)
    anywhere = random.uniform(0.0, 480.0, (400, 2))
    with pytest.raises(UserError, match=r"\d+ % of the 800 markers in the picture lie at places"):
        placement(sensor, [anywhere, anywhere], (480, 480))
    with pytest.raises(UserError, match="Is it another sensor"):
        placement(sensor, designed(load_sensor("flat-2019")), (320, 240))
