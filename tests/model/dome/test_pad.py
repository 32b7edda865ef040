"""The flat pad against half spaces, thin layers, finite elements and symmetry."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from chromagrip.model import Dome, Pad, Solid, dome_forces, press_and_move, simulate_contact
from chromagrip.model.dome import (
    MarkerField,
    Stepper,
    compliance_table,
    lattice,
    resting,
)
from chromagrip.model.dome.compliance import WIDTH, compliance_scale
from chromagrip.model.dome.layer import layer_motion, layer_moved, layer_slopes, wave_amplitudes
from chromagrip.model.kernels.dome.compliance_kernels import node_block
from chromagrip.model.shapes import ball, box, plane

FIXTURES = Path(__file__).parents[3] / "fixtures"
SMALL = Pad(radius=6e-3, pitch=0.6e-3)


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.48])
def test_waves_long_and_short(poisson: float) -> None:
    """A long wave squeezes and shears the layer as a whole, a short one sees a half space."""
    long, short = wave_amplitudes(np.array([1e-3, 40.0]), 1.0, poisson, 0.0).T
    confined = (1.0 - poisson) / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
    sheared = 2.0 * (1.0 + poisson)
    assert long[[0, 3, 4]] == pytest.approx([1.0 / confined, sheared, sheared], rel=1e-3)
    pressed = 2.0 * (1.0 - poisson**2) / 40.0
    assert short[[0, 3, 4]] == pytest.approx([pressed, pressed, sheared / 40.0], rel=1e-6)


def test_waves_are_in_equilibrium() -> None:
    """Navier's equations by differences over the depth, at every part of which it is measured."""
    poisson, k, step = 0.45, np.array([0.7, 2.0]), 1e-3
    depths = 0.4 + step * np.arange(-1, 2)
    uz, ux = np.moveaxis(
        np.stack([wave_amplitudes(k, 1.0, poisson, depth)[:2] for depth in depths]), 1, 0
    )
    bulk = 1.0 / (1.0 - 2.0 * poisson)  # of the divergence, over the shear modulus

    def slope(f: np.ndarray) -> np.ndarray:  # along z, which goes up
        return (f[0] - f[2]) / (2.0 * step)

    def bend(f: np.ndarray) -> np.ndarray:
        return (f[0] - 2.0 * f[1] + f[2]) / step**2

    along = bend(ux) - k**2 * ux[1] - bulk * k * (k * ux[1] + slope(uz))
    up = bend(uz) - k**2 * uz[1] + bulk * (k * slope(ux) + bend(uz))
    size = bulk * k**2 * (abs(ux[1]) + abs(uz[1]))
    assert abs(along / size).max() < 1e-5
    assert abs(up / size).max() < 1e-5


@pytest.mark.parametrize("poisson", [0.3, 0.48])
def test_a_thick_pad_is_a_half_space_near_a_force(poisson: float) -> None:
    """Boussinesq and Cerruti, but for a constant that the thickness makes."""
    far = layer_motion(50.0, poisson, 0.05, 10.0, 0.0)
    way = np.array([[1.0, 0.0], [2.0, 0.0], [0.0, 1.0], [0.0, 2.0]])
    moved = layer_moved(far, way)
    found = np.stack([moved[0] - moved[1], moved[2] - moved[3]])
    c = (1.0 + poisson) / (2.0 * math.pi)
    up, along, across = 2.0 * (1.0 - poisson), 2.0, 2.0 * (1.0 - poisson)
    aside = 1.0 - 2.0 * poisson
    ahead = c * np.array([[along, 0.0, aside], [0.0, across, 0.0], [-aside, 0.0, up]])
    beside = c * np.array([[across, 0.0, 0.0], [0.0, along, aside], [0.0, -aside, up]])
    assert found == pytest.approx(0.5 * np.stack([ahead, beside]), abs=0.02 * c)


@pytest.mark.parametrize("depth", [0.0, 0.7])
def test_slopes_are_those_of_the_motion(depth: float) -> None:
    motion = layer_motion(1.0, 0.48, 0.1, 10.0, depth)
    way, step = np.array([[0.3, -0.2], [0.0, 0.15], [1.1, 0.4], [0.0, 0.0]]), 1e-3
    slopes = layer_slopes(motion, way)
    for k, ahead in enumerate(step * np.eye(2)):
        rise = layer_moved(motion, way + ahead) - layer_moved(motion, way - ahead)
        expected = rise / (2.0 * step)
        assert slopes[..., k] == pytest.approx(expected, abs=2e-3 * abs(expected).max())


@pytest.mark.elements
def test_a_thin_dome_tends_to_a_pad() -> None:
    """An independent method: finite elements of domes of a radius of 16 and 33 thicknesses."""
    block, found = np.empty((3, 3)), []
    for thickness in (0.06, 0.03):
        dome = Dome(
            radius=1.0, core=1.0 - thickness, pitch=thickness / 1.8, reach=math.radians(20.0)
        )
        points, table = lattice(dome), compliance_table(dome)
        for apart in (1, 2, 4):
            node_block(table, len(points.angles), 4, 0.0, 4 + apart, 0.0, block)
            here, there = (_axes(points.angles[4 + k]) for k in (0, apart))
            scale = thickness * dome.young * compliance_scale(dome)
            found.append(scale * here @ block @ there.T)
    pitch = 1.0 / 1.8
    motion = layer_motion(1.0, 0.48, math.sqrt(2.0) * WIDTH * pitch, 20.0, 0.0)
    for thick, thin, apart in zip(found[:3], found[3:], (1, 2, 4), strict=True):
        flat = layer_moved(motion, np.array([-apart * pitch, 0.0]))
        assert thin == pytest.approx(flat, abs=0.08 * abs(flat).max()), apart
        assert 2.0 * thin - thick == pytest.approx(flat, abs=0.02 * abs(flat).max()), apart


def _axes(angle: float) -> np.ndarray:
    """Directions along the meridian, around and outwards, as rows of r, φ, z."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


@pytest.mark.stages
def test_a_wide_pressure_and_shear() -> None:
    """Silicone under the middle of a wide patch is squeezed, and shears in proportion to height."""
    pad = Pad(radius=13e-3, thickness=0.8e-3, pitch=0.4e-3)
    points = lattice(pad)
    tractions = np.array([2e3, 1e3, -20e3])
    forces = points.areas[:, None] * tractions
    depths = (0.0, 0.4e-3)
    around = np.column_stack([np.linspace(0.2e-3, 3e-3, 40), np.linspace(0.0, 50.0, 40)])
    moved = MarkerField(pad, np.stack([around] * 2), depths)(forces)[0].mean(axis=1)
    confined = pad.young * (1.0 - pad.poisson)
    confined /= (1.0 + pad.poisson) * (1.0 - 2.0 * pad.poisson)
    shear = pad.young / (2.0 * (1.0 + pad.poisson))
    for found, depth in zip(moved, depths, strict=True):
        height = pad.thickness - depth
        expected = height * tractions / [shear, shear, confined]
        assert found == pytest.approx(expected, rel=0.02), depth


def test_markers_have_slopes_along_their_own_axes() -> None:
    points, step = lattice(SMALL), 1e-5
    near = np.linalg.norm(points.points - [1e-3, 2e-3, 0.0], axis=1) < 1.2e-3
    forces = np.where(near[:, None], [0.02, 0.01, -0.05], 0.0)
    places = np.array([[2e-3, 0.8], [1e-3, 2.0], [3e-3, 4.0]])
    _, slopes = MarkerField(SMALL, places[None], (0.4e-3,))(forces)
    for k, length in ((0, np.ones(3)), (1, places[:, 0])):
        ahead = np.zeros_like(places)
        ahead[:, k] = step / length
        ends = [
            MarkerField(SMALL, (places + s * ahead)[None], (0.4e-3,))(forces)[0][0] for s in (-1, 1)
        ]
        expected = (ends[1] - ends[0]) / (2.0 * step)
        assert slopes[0, :, :, k] == pytest.approx(expected, abs=5e-3 * abs(expected).max())


def test_a_ball_on_a_thick_pad() -> None:
    """Hertz with the correction for a bonded incompressible layer of Dimitriadis et al. (2002)."""
    pad = Pad(
        radius=6e-3, thickness=6e-3, young=1e6, poisson=0.495, pitch=0.14e-3, stiffening=False
    )
    solid = Solid(shape=ball(8e-3), stiffness=1e12, friction=1e-9, dahl_stiffness=1e12)
    run = simulate_contact(pad, solid, press_and_move(0.1e-3), 0.01, keep=10)
    modulus = pad.young / (1.0 - pad.poisson**2)
    for state in run.states[3::3]:
        depth = 1e-3 * state.time
        chi = math.sqrt(8e-3 * depth) / pad.thickness
        share = 1.0 + 1.133 * chi + 1.283 * chi**2 + 0.769 * chi**3 + 0.0975 * chi**4
        hertz = 4.0 / 3.0 * modulus * math.sqrt(8e-3) * depth**1.5
        found = dome_forces(pad, state).total_normal
        assert found == pytest.approx(share * hertz, rel=0.012)


@pytest.mark.elements
@pytest.mark.parametrize(
    ("case", "law"),
    [
        ("nu 0.48 ball 20 slip", "linear"),
        ("nu 0.48 ball 10 stick", "linear"),
        ("nu 0.48 ball 10 stick", "hyperelastic"),
        ("nu 0.45 ball 10 slip", "hyperelastic"),
    ],
)
def test_presses_and_markers_are_those_of_finite_elements(case: str, law: str) -> None:
    """Linear ones closely, Neo-Hookean ones as near as the docs say."""
    book = json.loads((FIXTURES / "hyperelastic" / "pads.json").read_text(encoding="utf-8"))
    press = book["cases"][f"2000/1997.8 {case}"]
    pad = Pad(radius=10e-3, pitch=0.55e-3, poisson=press["nu"], stiffening=law != "linear")
    sticky = Solid(
        shape=ball(1e-3 * press["ball"]), stiffness=1e12,
        friction=5.0 if press["sticks"] else 1e-9, dahl_stiffness=1e12,
    )  # fmt: skip
    run = simulate_contact(pad, sticky, press_and_move(0.4 * pad.thickness), 2.5e-3, keep=40)
    steps = np.array(book["depths"][2:6]) / 0.4 * 0.1
    found = np.interp(steps, run.times, -run.total_forces[:, 2]) / (1e-6 * pad.young)
    most = {"linear": 0.04, "hyperelastic": 0.1}[law]
    assert found == pytest.approx(np.array(press[law]["force"][2:6]), rel=most)
    places = np.column_stack([np.array(book["along"]) * pad.thickness, np.zeros(3)])
    field = MarkerField(pad, np.stack([places] * 2), np.array(book["under"]) * pad.thickness)
    for i, share in enumerate(book["marked"][:2]):
        (state,) = (s for s in run.states if abs(s.time - share / 0.4 * 0.1) < 1e-6)
        moved = field(state.linear)[0] / pad.thickness
        expected = np.array(press[law]["markers"][i])
        off = np.linalg.norm(moved[..., [2, 0]] - expected, axis=-1).max()
        most = {"linear": 0.035, "hyperelastic": 0.15}[law]
        assert off < most * np.linalg.norm(expected, axis=-1).max()


def test_an_object_just_touches_it() -> None:
    for shape, height in ((plane(), 0.0), (ball(5e-3), 5e-3), (box((4e-3, 4e-3, 2e-3)), 1e-3)):
        solid, motion = Solid(shape=shape), press_and_move(0.1e-3)
        stepper = Stepper(SMALL, solid, motion, resting(SMALL, solid, motion))
        assert stepper.place[2] == pytest.approx(height, abs=1e-6)
