"""Signed distances of the shapes that are formulas, and how far each reaches down."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from chromagrip.errors import UserError
from chromagrip.model import shapes

SHAPES = {
    "plane": shapes.plane(),
    "ball": shapes.ball(5e-3),
    "rod": shapes.cylinder(4e-3),
    "cylinder": shapes.cylinder(4e-3, 10e-3),
    "rounded cylinder": shapes.cylinder(4e-3, 10e-3, 1e-3),
    "box": shapes.box(8e-3),
    "rounded box": shapes.box((8e-3, 6e-3, 4e-3), 1e-3),
    "pebble": shapes.box((8e-3, 6e-3, 4e-3), 2e-3),
    "capsule": shapes.capsule(2e-3, 10e-3),
    "torus": shapes.torus(6e-3, 2e-3),
    "cone": shapes.cone(4e-3, 8e-3),
    "rounded cone": shapes.cone(4e-3, 8e-3, 1e-3),
}
every_shape = pytest.mark.parametrize("name", SHAPES)


def cloud(count: int = 5000, reach: float = 12e-3) -> np.ndarray:
    return np.random.default_rng(3).uniform(-reach, reach, (count, 3))


def test_distances_are_those_of_other_formulas() -> None:
    p = cloud()
    x, y, z = p.T
    away = np.maximum(np.abs(p) - 4e-3, 0.0)
    inner = np.minimum((np.abs(p) - 4e-3).max(axis=1), 0.0)
    expected = {
        "plane": -z,
        "ball": np.linalg.norm(p, axis=1) - 5e-3,
        "rod": np.hypot(x, z) - 4e-3,
        "box": np.linalg.norm(away, axis=1) + inner,
        "torus": np.hypot(np.hypot(x, z) - 6e-3, y) - 2e-3,
        "capsule": np.linalg.norm(p - np.outer(np.clip(y, -3e-3, 3e-3), [0, 1, 0]), axis=1) - 2e-3,
    }
    for name, distance in expected.items():
        np.testing.assert_allclose(shapes.distances(SHAPES[name], p)[0], distance, atol=1e-15)


def test_a_cone_is_at_the_least_distance_to_its_side_and_its_base() -> None:
    p = cloud(300)
    t = np.linspace(0.0, 1.0, 20001)
    outline = np.concatenate(
        [np.column_stack([4e-3 * t, 8e-3 * t - 4e-3]), np.column_stack([4e-3 * t, 0 * t + 4e-3])]
    )
    rho, z = np.hypot(p[:, 0], p[:, 1]), p[:, 2]
    least = np.array([np.hypot(*(outline - q).T).min() for q in np.column_stack([rho, z])])
    inside = (z < 4e-3) & (rho < (z + 4e-3) / 2)
    gap, _ = shapes.distances(SHAPES["cone"], p)
    np.testing.assert_allclose(gap, np.where(inside, -least, least), atol=1e-9)


@every_shape
def test_normals_are_slopes_of_the_distance(name: str) -> None:
    p, h = cloud(), 1e-8
    gap, normal = shapes.distances(SHAPES[name], p)
    slope = np.stack(
        [
            (shapes.distances(SHAPES[name], p + e)[0] - shapes.distances(SHAPES[name], p - e)[0])
            / (2 * h)
            for e in h * np.eye(3)
        ],
        axis=1,
    )
    assert (np.abs(slope - normal).max(axis=1) > 1e-5).mean() < 1e-3  # a ridge lies between
    foot = p - gap[:, None] * normal
    np.testing.assert_allclose(shapes.distances(SHAPES[name], foot)[0], 0.0, atol=1e-15)


@every_shape
def test_centres_axes_and_edges_have_a_normal(name: str) -> None:
    axis = np.array([-4e-3, -3e-3, -1e-200, 0.0, 1e-300, 2e-3, 4e-3])
    p = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    gap, normal = shapes.distances(SHAPES[name], p)
    assert np.isfinite(gap).all()
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-12)


@pytest.mark.parametrize("name", [name for name in SHAPES if name not in ("plane", "rod")])
def test_a_turned_shape_reaches_down_to_its_lowest_point(name: str) -> None:
    """Against places on its surface: the feet of points around it."""
    shape = SHAPES[name]
    p = cloud(20_000)
    gap, normal = shapes.distances(shape, p)
    surface = p - gap[:, None] * normal
    assert (surface > shape.bounds[0] - 1e-12).all()
    assert (surface < shape.bounds[1] + 1e-12).all()
    for turn in Rotation.random(5, random_state=1).as_matrix():
        lowest = -(surface @ turn.T)[:, 2].min()
        assert lowest <= shape.reach_down(turn) + 1e-12
        assert shape.reach_down(turn) < lowest + 0.3e-3
        gap, _ = shapes.distances(shape, [-shape.reach_down(turn) * turn[2]])
        assert gap[0] >= -1e-15


def test_what_has_no_end_reaches_down_to_what_lies_below() -> None:
    tilt = Rotation.from_euler("x", 60.0, degrees=True).as_matrix()
    assert shapes.plane().reach_down(tilt) == 0.0
    assert SHAPES["rod"].reach_down() == pytest.approx(4e-3)
    assert SHAPES["rod"].reach_down(tilt) == pytest.approx(8e-3)
    with pytest.raises(UserError, match="must not stand upright"):
        SHAPES["rod"].reach_down(Rotation.from_euler("x", 90.0, degrees=True).as_matrix())
