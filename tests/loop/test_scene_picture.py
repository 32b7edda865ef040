"""Pictures of solids: silhouettes are those of geometry, and what is in front hides the rest."""

import math

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.loop.pinch.scene_picture import Body, Viewpoint, draw_bodies, look_from
from chromagrip.model.shapes import Shape, ball, box, plane

RED, BLUE = (220, 40, 40), (40, 40, 220)
X, Y, Z = np.eye(3)


def front(above: float = 0.0) -> Viewpoint:
    return look_from(np.zeros(3), X, Z, above=above, size=(200, 160), span=0.1)


def solid(shape: Shape, place: tuple[float, float, float], colour: tuple[int, int, int]) -> Body:
    return Body(shape=shape, place=np.array(place), rotation=np.eye(3), colour=colour)


def area(picture: np.ndarray, channel: int) -> int:
    others = [k for k in range(3) if k != channel]
    return int((picture[..., channel] > picture[..., others].max(axis=-1)).sum())


def test_a_ball_is_a_disc_wherever_one_looks_from() -> None:
    for above in (0.0, 0.4, 1.2):
        picture = draw_bodies([solid(ball(0.02), (0.0, 0.0, 0.0), RED)], front(above))
        assert area(picture, 0) == pytest.approx(math.pi * 40.0**2, rel=0.02)


def test_a_box_from_above_shows_two_sides_in_proportion() -> None:
    thing = solid(box((0.02, 0.03, 0.04)), (0.0, 0.0, 0.0), RED)
    above = 0.5
    height = 0.04 * math.cos(above) + 0.03 * math.sin(above)
    assert area(draw_bodies([thing], front(above)), 0) == pytest.approx(
        0.02 * height / 0.0005**2, rel=0.03
    )


def test_the_nearer_body_hides_the_other_whatever_their_order() -> None:
    view = front()
    near = solid(ball(0.01), tuple(0.03 * view.towards), RED)
    far = solid(ball(0.01), (0.0, 0.0, 0.0), BLUE)
    pictures = [draw_bodies(order, view) for order in ([near, far], [far, near])]
    assert np.array_equal(pictures[0], pictures[1])
    assert area(pictures[0], 2) == 0


def test_a_point_is_drawn_where_it_is_projected() -> None:
    view = front(0.3)
    place = np.array([0.02, 0.01, -0.015])
    picture = draw_bodies([solid(ball(0.003), tuple(place), RED)], view)
    rows, columns = np.nonzero(picture[..., 1] < 250)
    assert (columns.mean(), rows.mean()) == pytest.approx(view.project(place), abs=0.3)


def test_a_turned_body_is_drawn_turned() -> None:
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    thing = Body(shape=box((0.06, 0.01, 0.02)), place=np.zeros(3), rotation=turn, colour=RED)
    rows, columns = np.nonzero(draw_bodies([thing], front())[..., 1] < 250)
    assert np.ptp(rows) + 1 == pytest.approx(120, abs=2)
    assert np.ptp(columns) + 1 == pytest.approx(40, abs=2)


def test_a_plane_has_no_picture() -> None:
    with pytest.raises(UserError, match="of infinite size"):
        draw_bodies([solid(plane(), (0.0, 0.0, 0.0), RED)], front())
