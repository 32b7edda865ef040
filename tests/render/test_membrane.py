import numpy as np
import pytest
from msgspec.structs import replace

from chromagrip.model import Fingertip
from chromagrip.render import MembraneMap, SensorDesign, load_sensor
from chromagrip.render.design.layout import geodesic, unit_vectors
from chromagrip.render.design.skin import DomeSkin
from chromagrip.render.harmonics import harmonic_map

NODES = 251
SKIN = DomeSkin(radius=8e-3)
ANGLE = np.linspace(-np.pi / 2, np.pi / 2, NODES)


def test_exact_in_the_plane_of_the_chain() -> None:
    rng = np.random.default_rng(1)
    seen = rng.standard_normal((NODES, 2))
    node = np.array([3, 90, 120, 131, 200, 247])
    theta, phi = np.abs(ANGLE[node]), np.where(ANGLE[node] < 0, np.pi, 0.0)
    moved = harmonic_map(SKIN, np.column_stack([theta, phi]), NODES).displacement(seen)
    np.testing.assert_allclose(moved[:, [0, 2]], seen[node], atol=1e-9)
    np.testing.assert_allclose(moved[:, 1], 0.0, atol=1e-12)


def test_even_motion_is_carried_evenly() -> None:
    """A shift of the chain is one of the dome; a chain that grows radially is a dome that does."""
    directions = geodesic(100, 1.4, 0.1)
    carried = harmonic_map(SKIN, directions, NODES)
    moved = carried.displacement(np.tile([2.0, 3.0], (NODES, 1)))
    np.testing.assert_allclose(moved, np.tile([2.0, 0.0, 3.0], (100, 1)), atol=1e-12)
    moved = carried.displacement(np.column_stack([np.sin(ANGLE), np.cos(ANGLE)]))
    np.testing.assert_allclose(moved, unit_vectors(directions), atol=1e-4)


def test_gradient_is_the_derivative_along_the_dome() -> None:
    waves = np.stack([np.sin(k * (ANGLE + np.pi / 2)) for k in range(1, 6)], axis=1)
    seen = waves @ np.random.default_rng(2).standard_normal((5, 2))
    # On the nodes' own angles, where central differences are what the map interpolates.
    directions = np.column_stack([ANGLE[140:240:7], np.linspace(0.3, 6.0, 15)])
    along_theta, along_phi = harmonic_map(SKIN, directions, NODES).gradient(seen)
    h = 1e-3
    for k, (slope, scale) in enumerate(
        ((along_theta, 1.0), (along_phi, 1 / np.sin(directions[:, :1])))
    ):
        step = np.zeros(2)
        step[k] = h
        ahead = harmonic_map(SKIN, directions + step, NODES).displacement(seen)
        behind = harmonic_map(SKIN, directions - step, NODES).displacement(seen)
        np.testing.assert_allclose(slope, scale * (ahead - behind) / (2 * h), atol=0.02)


def test_a_turned_chain_carries_a_turned_skin() -> None:
    """Several displacements at once, against each by itself on the skin that is turned back."""
    places, azimuth = geodesic(100, 1.4, 0.1), 2.0
    several = np.random.default_rng(3).standard_normal((3, NODES, 2))
    moved, gradients = harmonic_map(SKIN, places, NODES, azimuth).many(several)
    alone = harmonic_map(SKIN, places - [0.0, azimuth], NODES)
    cos, sin = np.cos(azimuth), np.sin(azimuth)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    for seen, one, gradient in zip(several, moved, gradients, strict=True):
        np.testing.assert_allclose(one, alone.displacement(seen) @ turn.T, atol=1e-12)
        for k, expected in enumerate(alone.gradient(seen)):
            np.testing.assert_allclose(gradient[..., k], expected @ turn.T, atol=1e-9)


def test_discs_keep_their_size_and_tilt_with_the_skin() -> None:
    sensor = load_sensor("thesis")
    membrane_map = MembraneMap(sensor, NODES)
    rest = membrane_map(np.zeros((NODES, 2)))
    np.testing.assert_allclose(rest.normals[0], unit_vectors(sensor.places), atol=1e-9)
    pressed = np.zeros((NODES, 2))
    flat = np.abs(ANGLE) < 0.25
    pressed[flat, 1] = 8e-3 * (np.cos(0.25) - np.cos(ANGLE[flat]))
    bent = membrane_map(pressed)
    inside = sensor.places[:, 0] < 0.2
    assert bent.normals[0, inside, 2] == pytest.approx(1.0, abs=2e-3)
    np.testing.assert_allclose(np.linalg.norm(bent.axes, axis=2), 0.25e-3)
    np.testing.assert_allclose(
        (bent.axes[..., 0] * bent.axes[..., 1]).sum(axis=-1), 0.0, atol=1e-15
    )
    shift = bent.centres - rest.centres
    np.testing.assert_allclose(shift[1], 0.5 * shift[0], atol=1e-12)  # the inner layer follows


def test_layout_is_full_and_free_of_overlaps() -> None:
    sensor = load_sensor("thesis")
    directions = sensor.places
    assert directions[:, 0].max() <= np.deg2rad(85.0)
    vectors = unit_vectors(directions)
    cosine = vectors @ vectors.T - 2 * np.eye(400)
    nearest = np.arccos(cosine.max()) * (8e-3 - sensor.depths.max())
    assert nearest > 2 * sensor.half_sizes.max()
    on_meridian = np.abs(np.sin(directions[:, 1])) < 1e-9
    assert on_meridian.sum() == 31  # 0.75 mm apart over ±85° of 8 mm


def test_unevenly_spaced_nodes_carry_the_same_skin() -> None:
    """A graded chain's displacements and slopes are those of the field that it samples."""
    places = geodesic(100, 1.4, 0.1)
    graded = Fingertip.graded(99)
    at = graded.angles()
    even = harmonic_map(SKIN, places, 2001)
    uneven = harmonic_map(SKIN, places, at)

    def field(angle: np.ndarray) -> np.ndarray:
        return np.column_stack([np.sin(2 * angle) + 0.3 * np.cos(angle), np.cos(3 * angle)])

    fine = field(np.linspace(-np.pi / 2, np.pi / 2, 2001))
    moved = uneven.displacement(field(at)) - even.displacement(fine)
    # Linear interpolation is off by up to h²/8 times the second derivative, here at most 9.
    assert abs(moved).max() < np.diff(at).max() ** 2 / 8 * 9
    near = places[:, 0] < 0.45  # where it is as fine as 251 nodes
    for one, other in zip(uneven.gradient(field(at)), even.gradient(fine), strict=True):
        assert abs(one - other)[near].max() < 0.02


def changed_markers(**values: float) -> SensorDesign:
    sensor = load_sensor("thesis")
    return replace(sensor, markers=replace(sensor.markers, **values))


def test_ink_stretches_with_the_skin_and_dots_do_not() -> None:
    """Blown up by a tenth, the skin takes ink along, and leaves stiff dots as they are."""
    radial = 0.1 * 8e-3 * np.column_stack([np.sin(ANGLE), np.cos(ANGLE)])
    near = load_sensor("thesis").places[:, 0] < 1.3
    for share in (0.0, 0.5, 1.0):
        membrane = MembraneMap(changed_markers(stretch=share), NODES)(radial)
        size = np.linalg.norm(membrane.axes[0, near], axis=1)
        # A displacement by a tenth of the radius stretches the layer 0.3 mm below by a bit more.
        np.testing.assert_allclose(size, 0.25e-3 * (1.0 + share * 0.8 / 7.7), rtol=2e-3)


def test_pressed_silicone_swells_by_what_it_loses_in_thickness() -> None:
    """Incompressible: area times thickness stays; the layer that does not move does not swell."""
    sensor = changed_markers(swell_mm=2.0)
    sensor = replace(sensor, yellow=replace(sensor.yellow, follow=0.0))
    squeezed = -0.4e-3 * np.column_stack([np.sin(ANGLE), np.cos(ANGLE)])
    membrane = MembraneMap(sensor, NODES)(squeezed)
    near = sensor.places[:, 0] < 1.3
    area = np.linalg.norm(np.cross(membrane.axes[..., 0], membrane.axes[..., 1]), axis=-1)
    np.testing.assert_allclose(area[0, near] * (2.0 - 0.4) / 2.0, 0.25e-3**2, rtol=1e-3)
    np.testing.assert_allclose(area[1], 0.25e-3**2, rtol=1e-12)


def test_squares_lie_along_x_and_y_and_turn_with_the_skin() -> None:
    sensor = load_sensor("flat-2019")
    rest = MembraneMap(sensor, 51)(np.zeros((51, 2)))
    np.testing.assert_allclose(rest.axes[0, :, :, 0], np.tile([1e-3, 0, 0], (100, 1)), atol=1e-15)
    np.testing.assert_allclose(rest.axes[0, :, :, 1], np.tile([0, 1e-3, 0], (100, 1)), atol=1e-15)
    # Tilted as a whole about y: heights fall along x.
    x = np.linspace(-18e-3, 18e-3, 51)
    tilted = MembraneMap(sensor, 51)(np.column_stack([np.zeros(51), -0.1 * x]))
    lean = tilted.normals[0][np.hypot(*rest.centres[0, :, :2].T) < 15e-3]
    np.testing.assert_allclose(
        lean, np.tile([0.1, 0.0, 1.0] / np.hypot(0.1, 1), (len(lean), 1)), atol=1e-9
    )


def test_markers_outside_the_outermost_nodes_stay() -> None:
    """A pad's corners are farther from its middle than its rim, which is held."""
    sensor = load_sensor("flat-2019")
    x = np.linspace(-sensor.shape.half, sensor.shape.half, 251)
    held = np.clip((sensor.shape.half - abs(x)) / 1e-3, 0.0, 1.0)
    moved = np.column_stack([5e-4 * held, -5e-4 * held])
    mapped = MembraneMap(sensor, 251)
    rest, pressed = mapped(np.zeros_like(moved)), mapped(moved)
    outside = sensor.places[:, 0] > sensor.shape.half
    assert outside.sum() >= 4
    np.testing.assert_allclose(pressed.centres[:, outside], rest.centres[:, outside], atol=1e-12)
    np.testing.assert_allclose(pressed.axes[:, outside], rest.axes[:, outside], atol=1e-12)
    middle = sensor.places[:, 0] < 0.5 * sensor.shape.half
    np.testing.assert_allclose((pressed.centres - rest.centres)[0, middle, 0], 5e-4, rtol=1e-9)
