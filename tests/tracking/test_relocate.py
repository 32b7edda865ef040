import numpy as np
import pytest
from scipy.spatial import KDTree

from chromagrip.model import Fingertip
from chromagrip.render import Frame, MembraneMap, add_noise, load_sensor, open_renderer
from chromagrip.render.outlines import centroids, outlines
from chromagrip.tracking import Palette, read_rest
from chromagrip.tracking.fit.relocate import Relocator

SENSOR = load_sensor("thesis")
TIP = Fingertip()
MAP = MembraneMap(SENSOR, TIP.nodes)
PAINTER = open_renderer("painter", SENSOR)


def picture(pitches: float, light: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Image with the apex moved by so many pitches of 0.98 mm, and its centres (2, M, 2)."""
    angle = np.clip(TIP.angles() / 1.48, -1.0, 1.0)
    seen = np.cos(0.5 * np.pi * angle)[:, None] ** 2 * [0.98e-3 * pitches, -0.3e-3]
    membrane = MAP(seen)
    image = np.rint(PAINTER.render(membrane) * np.linspace(1.0, light, 640)[:, None])
    image = image.astype(np.uint8)
    add_noise(image, 2.0, 5, 1)
    return image, centroids(outlines(membrane, SENSOR.view), square=False)


@pytest.fixture(scope="module")
def relocator() -> tuple[Relocator, np.ndarray]:
    """And the marker of the design that each number is."""
    image, truth = picture(0.0)
    rest = read_rest([Frame(image=image, time=0.0)], Palette.of_sensor(SENSOR))
    return Relocator(rest, Palette.of_sensor(SENSOR)), KDTree(truth[0]).query(rest.position[0])[1]


@pytest.mark.parametrize(("pitches", "light"), [(0.5, 1.0), (1.2, 0.6), (2.0, 1.0)])
def test_numbers_do_not_depend_on_how_far_it_went(
    relocator: tuple[Relocator, np.ndarray], pitches: float, light: float
) -> None:
    find, order = relocator
    image, truth = picture(pitches, light)
    located = find(image)
    assert located.found.mean() > 0.99
    apart = np.linalg.norm(located.position - truth[:, order], axis=-1)
    assert apart[located.found].max() < 1.0
    assert np.median(located.gains[:, 1]) == pytest.approx(((1 + light) / 2) ** 2.2, rel=0.05)


def test_an_image_without_markers_has_none(relocator: tuple[Relocator, np.ndarray]) -> None:
    located = relocator[0](np.full((480, 640, 3), 200, dtype=np.uint8))
    assert not located.found.any()
    assert np.isfinite(located.position).all()
