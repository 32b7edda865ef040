"""What every renderer promises, and the brute force that all are compared with."""

from collections.abc import Iterator
from contextlib import closing
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from chromagrip.errors import UserError
from chromagrip.loop.run import run
from chromagrip.render import (
    RENDERERS,
    Membrane,
    MembraneMap,
    Renderer,
    SensorDesign,
    decode_srgb,
    encode_srgb,
    gl_problem,
    ground_image,
    load_sensor,
    open_renderer,
    rest_membrane,
)
from chromagrip.render.design.sensor import Spiral
from chromagrip.render.drawing.painter import Painter
from chromagrip.render.drawing.supersampled import supersampled_image
from chromagrip.scene.scene import load_scene

THESIS, FLAT = load_sensor("thesis"), load_sensor("flat-2019")
FOCAL, MIDDLE = 152.8, np.array([47.5, 35.5])
#: The middle of the thesis' fingertip, and of the flat sensor.
DISCS = replace(
    THESIS,
    layout=Spiral(count=9, coverage_deg=11.0),
    camera=replace(THESIS.camera, width_px=96, height_px=72),
)
SQUARES = replace(
    FLAT,
    layout=replace(FLAT.layout, rows=5, columns=5),
    camera=replace(FLAT.camera, width_px=96, height_px=96),
)
REST = rest_membrane(DISCS)
#: Channel that a layer's dye darkens most.
CHANNEL = (1, 2)


class BruteForce:
    """The reference as a renderer."""

    def __init__(self, sensor: SensorDesign) -> None:
        self.sensor = sensor

    def render(self, membrane: Membrane) -> np.ndarray:
        return supersampled_image(self.sensor, membrane)

    def close(self) -> None: ...


CHOICES = {**{name: name for name in RENDERERS.entries}, "supersampled": BruteForce}


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(name, marks=pytest.mark.stages if name == "pyrender" else ())
        for name in CHOICES
    ],
)
def choice(request: pytest.FixtureRequest) -> object:
    usable(request.param)
    return CHOICES[request.param]


def usable(name: str) -> None:
    problem = gl_problem() if name == "pyrender" else None
    if problem is not None:
        pytest.skip(problem)


@pytest.fixture(scope="module")
def renderer(choice: str) -> Iterator[Renderer]:
    with closing(open_renderer(choice, DISCS)) as made:
        yield made


def dots(*places: tuple[int, float, float], radius: float = 0.25) -> Membrane:
    """Discs of a radius [mm] across the axis, at (layer, x, y) [mm]; other markers are missing."""
    centres = np.full_like(REST.centres, np.nan)
    for k, (layer, x, y) in enumerate(places):
        centres[layer, k] = [1e-3 * x, 1e-3 * y, 7.5e-3]
    axes = np.broadcast_to(1e-3 * radius * np.eye(3)[:, :2], REST.axes.shape)
    return Membrane(centres=centres, axes=axes.copy())


def dented(sensor: SensorDesign) -> Membrane:
    """Membrane with a dent that is dragged along x, its yellow layer out of register."""
    place = np.linspace(-1.0, 1.0, 201)
    dent = 0.2e-3 * np.exp(-((place / 0.25) ** 2))
    mapped = MembraneMap(sensor, 201)(np.column_stack([0.6 * dent, -dent]))
    shift = 0.15 * np.random.default_rng(2).standard_normal((len(sensor.places), 2))
    centres = mapped.centres.copy()
    centres[1] += np.einsum("mki,mi->mk", mapped.axes[1], shift)
    return Membrane(centres=centres, axes=mapped.axes)


def covered(image: np.ndarray, clear: np.ndarray, layer: int) -> np.ndarray:
    """Share of each pixel that a layer's dye covers, from the light that it takes away."""
    light, whole = (decode_srgb(each[..., CHANNEL[layer]].astype(float)) for each in (image, clear))
    return (1.0 - light / whole) / (1.0 - DISCS.transmittance[layer, CHANNEL[layer]])


def projected(x: float, y: float, radius: float = 0.25) -> tuple[float, np.ndarray]:
    """Area [px²] and centroid [px] of the image of a disc: its outline through OpenCV's fisheye."""
    angle = np.linspace(0.0, 2 * np.pi, 720, endpoint=False)
    circle = np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), 7.5 + 0 * angle], 1)
    matrix = np.array([[FOCAL, 0.0, MIDDLE[0]], [0.0, FOCAL, MIDDLE[1]], [0.0, 0.0, 1.0]])
    zero = np.zeros(3)
    corners, _ = cv2.fisheye.projectPoints(circle[:, None], zero, zero, matrix, np.zeros(4))
    moments = cv2.moments((corners[:, 0] - MIDDLE).astype(np.float32))
    area = moments["m00"]
    return area, MIDDLE + np.array([moments["m10"], moments["m01"]]) / area


def test_a_picture_depends_on_its_membrane_alone(renderer: Renderer) -> None:
    first = renderer.render(REST)
    assert (first.shape, first.dtype) == ((72, 96, 3), np.uint8)
    kept, other = first.copy(), renderer.render(dented(DISCS))
    assert (other != first).any()
    assert (first == kept).all()
    first[:] = 0
    assert (renderer.render(REST) == kept).all()


def test_nothing_is_drawn_of_missing_markers_and_outside(renderer: Renderer) -> None:
    clear = renderer.render(dots())
    ground = encode_srgb(ground_image(DISCS).astype(float))
    assert abs(clear - ground).max() <= 1.0
    assert (renderer.render(dots((0, 7.0, 0.0), (1, 0.0, -6.0))) == clear).all()
    # Half of a dot on the border, where the picture ends half a pixel beyond its pixels' centres.
    x = 7.5 * np.tan(48.0 / FOCAL)
    half = covered(renderer.render(dots((0, x, 0.3))), clear, 0)
    assert half.sum() == pytest.approx(0.5 * projected(x, 0.3)[0], rel=0.05)
    assert (half[:, :88] == 0.0).all()


@pytest.mark.parametrize("layer", [0, 1])
def test_a_dot_has_its_area_and_place_and_moves_as_projected(
    renderer: Renderer, layer: int
) -> None:
    clear = renderer.render(dots())
    y, x = np.mgrid[:72, :96]
    found, expected = [], []
    for place in ((1.0, -0.6), (1.13, -0.85), (-2.1, 1.2)):
        dark = covered(renderer.render(dots((layer, *place))), clear, layer)
        area, centroid = projected(*place)
        assert dark.sum() == pytest.approx(area, rel=0.012)
        found.append(np.array([(dark * x).sum(), (dark * y).sum()]) / dark.sum())
        expected.append(centroid)
    np.testing.assert_allclose(found, expected, atol=0.01)
    np.testing.assert_allclose(np.diff(found, axis=0), np.diff(expected, axis=0), atol=0.01)


def test_dyes_multiply_where_layers_overlap(renderer: Renderer) -> None:
    image = renderer.render(dots((0, -0.5, 0.0), (1, 0.5, 0.0), radius=1.0))
    ground, (magenta, yellow) = ground_image(DISCS)[36, 48].astype(float), DISCS.transmittance
    for x, dye in ((0.0, magenta * yellow), (-1.1, magenta), (1.1, yellow), (2.2, 1.0)):
        at = round(MIDDLE[0] + FOCAL * np.arctan(x / 7.5))
        np.testing.assert_allclose(image[36, at], encode_srgb(ground * dye), atol=1.0)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_membrane_has_a_mirrored_picture(renderer: Renderer, axis: int) -> None:
    membrane, mirror = dented(DISCS), np.ones(3)
    mirror[axis] = -1.0
    turned = Membrane(centres=membrane.centres * mirror, axes=membrane.axes * mirror[:, None])
    image = np.flip(renderer.render(membrane), axis=1 - axis).astype(int)
    off = abs(renderer.render(turned) - image).max(axis=-1)
    # Samples lie the same way on both sides of a line for all but OpenGL, on whose lines some fall.
    assert (off > 1).mean() < 0.002
    assert off.max() < 8


def test_light_scales_with_the_ground(choice: str, renderer: Renderer) -> None:
    """Two of a kind are open, of which one is closed before the other."""
    dark = replace(DISCS, ground=replace(DISCS.ground, apex=(128, 100, 80)))
    with closing(open_renderer(choice, dark)) as made:
        images = [each.render(REST)[18:54, 24:72] for each in (made, renderer)]
    lights = [decode_srgb(image.astype(float)) for image in images]  # of the middle, off the rim
    ratio = np.divide(*(decode_srgb(np.array(d.ground.apex, float)) for d in (dark, DISCS)))
    np.testing.assert_allclose(lights[0], lights[1] * ratio, atol=0.004)
    np.testing.assert_array_equal(renderer.render(REST)[18:54, 24:72], images[1])


@cache
def brute_force(name: str) -> tuple[SensorDesign, Membrane, np.ndarray]:
    sensor = {"discs": DISCS, "squares": SQUARES}[name]
    return sensor, dented(sensor), supersampled_image(sensor, dented(sensor)).astype(int)


@pytest.mark.parametrize("name", ["discs", "squares"])
def test_pictures_are_those_of_brute_force(choice: str, name: str) -> None:
    """Against 81 samples a pixel, blurred as light is."""
    sensor, membrane, exact = brute_force(name)
    with closing(open_renderer(choice, sensor)) as made:
        off = made.render(membrane) - exact
    # Discs to three levels; at corners, and where both layers' edges nearly meet, less well.
    assert abs(off).max() <= {"discs": 3, "squares": 8}[name]
    assert abs(off).mean() < {"discs": 0.1, "squares": 0.6}[name]
    assert abs(off.mean()) < 0.1


@pytest.mark.stages
def test_a_slow_renderer_draws_a_picture_like_brute_force() -> None:
    usable("pyrender")
    test_pictures_are_those_of_brute_force("pyrender", "discs")


MODULE = """
from chromagrip.render.drawing.painter import Painter

class Dim(Painter):
    def __init__(self, sensor, share=0.5):
        super().__init__(sensor)
        self._share = share
    def render(self, membrane):
        return (self._share * super().render(membrane)).astype("uint8")

class Blind:
    def close(self):
        pass
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "somebodys_renderer.py").write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    return "somebodys_renderer"


def test_a_renderer_of_a_module_takes_arguments(module: str) -> None:
    bright = Painter(DISCS).render(REST).mean()
    for arguments, share in ((None, 0.5), ({"share": 0.25}, 0.25)):
        dim = open_renderer(f"{module}:Dim", DISCS, arguments)
        assert dim.render(REST).mean() == pytest.approx(share * bright, abs=1)
    assert isinstance(open_renderer(partial(Painter, redraw=True), DISCS), Painter)
    scene = load_scene(changes={"renderer": f"{module}:Dim", "duration_s": 0.02, "path": "truth"})
    assert run(scene).summary["renderer"] == f"{module}:Dim"


def test_renderers_that_cannot_be_are_refused(module: str, monkeypatch: pytest.MonkeyPatch) -> None:
    gl = "chromagrip.render.drawing.mesh_renderer.gl_problem"
    monkeypatch.setattr(gl, lambda: "no off-screen OpenGL context: test")
    for name, words in (
        ("crayon", r"no renderer 'crayon'; there is painter, pyrender, or"),
        (f"{module}:Blind", r"somebodys_renderer:Blind' has no render; see chromagrip"),
        ("pyrender", r"pyrender cannot run here.*apt-get install"),
    ):
        with pytest.raises(UserError, match=words):
            open_renderer(name, DISCS)
