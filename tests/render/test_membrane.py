import numpy as np
import pytest

from chromagrip.render import MembraneMap, load_sensor
from chromagrip.render.harmonics import harmonic_map
from chromagrip.render.layout import geodesic, unit_vectors
from chromagrip.render.skin import DomeSkin

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


def test_carrying_the_chain_along_carries_the_whole_dome() -> None:
    directions = geodesic(100, 1.4, 0.1)
    seen = np.tile([2.0, 3.0], (NODES, 1))
    moved = harmonic_map(SKIN, directions, NODES).displacement(seen)
    np.testing.assert_allclose(moved, np.tile([2.0, 0.0, 3.0], (100, 1)), atol=1e-12)


def test_squeezing_a_symmetric_chain_squeezes_the_dome_evenly() -> None:
    directions = geodesic(100, 1.4, 0.1)
    seen = np.column_stack([np.sin(ANGLE), np.cos(ANGLE)])  # grows radially
    moved = harmonic_map(SKIN, directions, NODES).displacement(seen)
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
    assert directions.shape == (400, 2)
    assert directions[:, 0].max() <= np.deg2rad(85.0)
    vectors = unit_vectors(directions)
    cosine = vectors @ vectors.T - 2 * np.eye(400)
    nearest = np.arccos(cosine.max()) * (8e-3 - sensor.depths.max())
    assert nearest > 2 * sensor.half_sizes.max()
    on_meridian = np.abs(np.sin(directions[:, 1])) < 1e-9
    assert on_meridian.sum() == 31  # 0.75 mm apart over ±85° of 8 mm
