"""Motion inside the dome against analysis, differences, symmetry and the skin's own compliance."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from chromagrip.model import Dome, Pad, SoftBody, Solid, press_and_move, simulate_contact
from chromagrip.model.dome import MarkerField, SkinField, lattice
from chromagrip.model.dome.inside import _spline
from chromagrip.model.kernels.dome.inside_kernels import add_columns
from chromagrip.model.shapes import ball, plane

FIXTURES = Path(__file__).parents[3] / "fixtures"

SMALL = Dome(pitch=0.8e-3, reach=math.radians(50.0))
PAD = Pad(radius=6e-3, pitch=0.6e-3)
_RNG = np.random.default_rng(0)
PLACES = np.column_stack([_RNG.uniform(0.1, 0.8, 40), _RNG.uniform(0.0, 6.0, 40)])


def _patch(dome: Dome, centre: tuple[float, float, float], count: int) -> np.ndarray:
    """Uneven forces in all directions on the nodes nearest to a direction."""
    points = lattice(dome).points
    near = np.argsort(np.linalg.norm(points / dome.radius - centre, axis=1))[:count]
    forces = np.zeros_like(points)
    forces[near] = np.random.default_rng(2).normal([0.01, 0.02, -0.03], 0.01, (count, 3))
    return forces


def _moved(dome: Dome, places: np.ndarray, depth: float, forces: np.ndarray) -> np.ndarray:
    return MarkerField(dome, places[None], (depth,))(forces)[0][0]


@pytest.mark.parametrize("body", [SMALL, PAD], ids=lambda body: body.kind)
def test_silicone_that_is_bonded_to_the_core_stays(body: SoftBody) -> None:
    points = lattice(body)
    forces = points.areas[:, None] * np.where(points.points[:, :1] > 0.0, [1e3, 2e3, -3e3], 0.0)
    unit = body.radius if isinstance(body, Pad) else 1.0
    places = PLACES * [unit, 1.0]
    field = MarkerField(body, np.stack([places] * 2), (0.4e-3, body.thickness))
    displacement, slopes = field(forces)
    assert abs(displacement[0]).max() > 1e-6
    assert abs(displacement[1]).max() < 1e-9 * abs(displacement[0]).max()
    assert abs(slopes[1]).max() < 1e-6 * abs(slopes[0]).max()


@pytest.mark.parametrize("depth", [0.4e-3, 1.2e-3])
def test_slopes_are_those_of_the_displacement(depth: float) -> None:
    forces, step = _patch(SMALL, (0.3, 0.2, 0.93), 9), 4e-3
    _, slopes = MarkerField(SMALL, PLACES[None], (depth,))(forces)
    for k in range(2):
        ahead, behind = PLACES.copy(), PLACES.copy()
        ahead[:, k] += step
        behind[:, k] -= step
        rise = _moved(SMALL, ahead, depth, forces) - _moved(SMALL, behind, depth, forces)
        length = 2.0 * step * (SMALL.radius - depth) * (np.sin(PLACES[:, 0]) if k else 1.0)
        expected = rise / np.broadcast_to(length, 40)[:, None]
        assert slopes[0, :, :, k] == pytest.approx(expected, abs=4e-3 * abs(expected).max())


def test_the_apex_is_no_place_of_its_own() -> None:
    """On either side of the axis the same displacement and, turned, the same slopes."""
    forces = _patch(SMALL, (0.1, 0.2, 0.97), 12)
    places = np.array([[2e-3, 0.4], [2e-3, 0.4 + math.pi]])
    displacement, slopes = MarkerField(SMALL, places[None], (0.8e-3,))(forces)
    between = 4e-3 * (SMALL.radius - 0.8e-3)
    rise = displacement[0, 0] - displacement[0, 1]
    assert rise == pytest.approx(between * slopes[0, 0, :, 0], abs=0.02 * abs(rise).max())
    assert slopes[0, 0] == pytest.approx(-slopes[0, 1], abs=0.04 * abs(slopes).max())


def test_markers_just_under_the_skin_move_as_it_does() -> None:
    """Under a pressure and a shear that are smooth on the scale of the nodes."""
    points = lattice(SMALL)
    bump = np.exp(-0.5 * ((points.points[:, :2] - [1e-3, 0.5e-3]) ** 2).sum(axis=1) / 1.6e-3**2)
    forces = (points.areas * bump)[:, None] * [0.3e5, 0.1e5, -0.6e5]
    skin = SkinField(SMALL)(forces)
    places = np.column_stack([points.angles[points.ring], points.azimuth])
    below = _moved(SMALL, places, 0.05e-3, forces)
    inner = places[:, 0] < 0.6
    apart = np.linalg.norm(below[inner] - skin[inner])
    assert apart < 0.03 * np.linalg.norm(skin[inner])


@pytest.mark.elements
def test_a_thick_dome_moves_inside_as_a_half_space() -> None:
    """u_z = (1 + ν)·F/(2π·E·ρ)·(z²/ρ² + 2·(1 − ν)) of Boussinesq, from one depth to another."""
    poisson = 0.48
    dome = Dome(core=0.5e-3, poisson=poisson, pitch=0.25e-3, reach=math.radians(20.0))
    points = lattice(dome)
    forces = np.zeros_like(points.points)
    forces[:3, 2] = -1.0 / 3.0  # the innermost ring, 0.125 mm from the axis
    axis, depths = np.array([[[0.0, 0.0]]]), (0.6e-3, 0.9e-3)
    moved = [-MarkerField(dome, axis, (depth,))(forces)[0][0, 0, 2] for depth in depths]

    def boussinesq(z: float) -> float:
        rho = math.hypot(z, 0.125e-3)
        first = (1.0 + poisson) / (2.0 * math.pi * dome.young * rho)
        return first * (z**2 / rho**2 + 2.0 * (1.0 - poisson))

    expected = boussinesq(depths[0]) - boussinesq(depths[1])
    assert moved[0] - moved[1] == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("count", [0, 1, 3, 11])
def test_columns_add_up_whatever_their_number(count: int) -> None:
    rng = np.random.default_rng(count)
    columns = rng.normal(size=(12, 3, 50)).astype(np.float32)
    slots, forces = rng.permutation(12)[:count], rng.normal(size=(count, 3))
    total = np.full(50, np.nan, np.float32)
    add_columns(columns, slots, forces, total)
    expected = np.einsum("na,nav->v", forces, columns[slots].astype(float))
    np.testing.assert_allclose(total, expected, rtol=0, atol=1e-5)


def test_a_spline_by_products_is_the_spline() -> None:
    """At its stations, between them and a little beyond their ends."""
    rng = np.random.default_rng(3)
    stations = np.cumsum(rng.uniform(0.5, 1.5, 30))
    values = rng.normal(size=(30, 4))
    places = np.concatenate([stations, rng.uniform(stations[0] - 0.2, stations[-1] + 0.2, 90)])
    slopes, between = _spline(stations, places)
    value, derivative = (between @ np.concatenate([values, slopes @ values])).reshape(2, -1, 4)
    spline = CubicSpline(stations, values)
    np.testing.assert_allclose(value, spline(places), rtol=0, atol=1e-12)
    np.testing.assert_allclose(derivative, spline(places, 1), rtol=0, atol=1e-12)


def test_columns_that_no_longer_fit_are_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    field = MarkerField(SMALL, PLACES[None], (0.8e-3,))
    first, second = _patch(SMALL, (0.3, 0.2, 0.93), 9), _patch(SMALL, (-0.3, 0.2, 0.93), 9)
    before = field(first)[0].copy(), field(second)[0].copy()
    monkeypatch.setattr("chromagrip.model.dome.inside._ROOM", 12 * 9 * 40 * 10)
    small = MarkerField(SMALL, PLACES[None], (0.8e-3,))
    for _ in range(2):
        assert np.array_equal(small(first)[0], before[0])
        assert np.array_equal(small(second)[0], before[1])


@pytest.mark.parametrize("case", ["8/6 nu 0.48 plane stick", "8/6 nu 0.48 ball 20 stick"])
def test_markers_at_depth_are_those_of_finite_elements(case: str) -> None:
    """At the same press: of linear silicone, and of Neo-Hookean silicone as near as docs say."""
    book = json.loads((FIXTURES / "hyperelastic" / "presses.json").read_text(encoding="utf-8"))
    press = book["cases"][case]
    dome = Dome(reach=math.radians(35.0))
    places = np.column_stack([np.array(book["along"]) * dome.thickness / dome.radius, np.zeros(3)])
    field = MarkerField(dome, np.stack([places] * 2), np.array(book["under"]) * dome.thickness)
    shape = plane() if press["ball"] is None else ball(1e-3 * press["ball"])
    sticky = Solid(shape=shape, stiffness=1e12, friction=5.0, dahl_stiffness=1e12)
    motion = press_and_move(0.3 * dome.thickness, press_s=0.03)
    run = simulate_contact(dome, sticky, motion, 1e-3, keep=100)
    for i, (time, share) in enumerate([(0.015, 0.045), (0.03, 0.11)]):
        (state,) = (s for s in run.states if abs(s.time - time) < 1e-6)
        moved = field(state.linear)[0] / dome.thickness
        found = np.stack([moved[..., 2], moved[..., 0]], axis=-1)
        for law, most in (("linear", 0.02), ("hyperelastic", share)):
            expected = np.array(press[law]["markers"][i])
            off = np.linalg.norm(found - expected, axis=-1).max()
            assert off < most * np.linalg.norm(expected, axis=-1).max(), law
