"""A pinch in space: from one side, and along its axis."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model import Dome, Pad, SoftBody
from ...model.pinch import FACING, Pinch, bases, rotation_by
from ...model.shapes import Shape, ball, box, cylinder, reach_down
from .scene_picture import Body, Colour, Viewpoint, draw_bodies, look_from
from .world import Pinched

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Colours of both fingers' silicone, and of the table.
FINGER_COLOURS: tuple[Colour, Colour] = (70, 130, 200), (90, 160, 110)
TABLE: Colour = (190, 178, 160)
#: Colours of lines and marks.
INK: Colour = (60, 60, 60)
#: Place of the scale of heights from the left [px].
_SCALE = 40

DOWN = np.array([1.0, 0.0, 0.0])
AXIS = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class Stage:
    """Pinch, table and viewpoints, which stay the same in all its pictures.

    The world's x is down in the picture, and its z to the right: from the first finger to the
    second one.

    Attributes
    ----------
    pinch: pinch that is shown
    bases: origins of the fingertips in the hand [m], each (3,)
    start: centre of mass of the object at the start [m], shape (3,)
    table: table on which the object stands; None: no table
    side: viewpoint in front of the pinch, which shows the whole path
    along: viewpoint from the first finger, in the hand's frame
    """

    pinch: Pinch
    bases: tuple[Array, Array]
    start: Array
    table: Body | None
    side: Viewpoint
    along: Viewpoint


def set_stage(
    pinch: Pinch, duration: float, size: tuple[int, int], small: tuple[int, int]
) -> Stage:
    """Set the stage of a pinch.

    Parameters
    ----------
    pinch: pinch that is shown
    duration: length of the path that the picture must hold [s]
    size: width and height of the picture from the side [px]
    small: width and height of the picture along the pinch [px]
    """
    base = bases(pinch)
    bodies = [
        _posed(pinch, base, pinch.hand.at(time), 0.0) for time in np.linspace(0.0, duration, 120)
    ]
    table = _table(pinch, bodies[0][0]) if pinch.table else None
    ends = np.concatenate(
        [body.corners for posed in bodies for body in posed]
        + ([table.corners] if table is not None else [])
    )
    reach = 1.15 * max(pinch.first.radius, pinch.second.radius, _reach(pinch.solid.shape))
    start = bodies[0][0]
    return Stage(
        pinch=pinch,
        bases=base,
        start=start.place + start.rotation @ np.array(pinch.body.centre),
        table=table,
        side=_holding(ends, size),
        along=look_from(
            np.zeros(3), np.cross(AXIS, -DOWN), -DOWN, above=0.0, size=small,
            span=2.0 * reach * small[0] / min(small),
        ),
    )  # fmt: skip


def draw_side(stage: Stage, now: Pinched) -> Image:
    """Draw the picture from the side, with a scale of heights, RGB."""
    posed = _now(stage, now, stage.pinch.hand.at(now.state.time))
    table = [] if stage.table is None else [stage.table]
    picture = draw_bodies([*posed, *table], stage.side)
    for name, housing in (("1", posed[2]), ("2", posed[4])):
        x, y = _pixel(stage.side, housing.place)
        cv2.putText(
            picture, name, (x - 6, y + 7), cv2.FONT_HERSHEY_SIMPLEX, 0.7, (235, 235, 235), 1,
            cv2.LINE_AA,
        )  # fmt: skip
    _draw_heights(picture, stage, now.state.moving.place)
    return picture


def draw_along(stage: Stage, now: Pinched) -> Image:
    """Draw the picture in the hand, from the first finger (a ring) towards the second, RGB."""
    object_, *others = _now(stage, now, (np.zeros(3), np.eye(3)))
    silicone = others[2]
    picture = draw_bodies([object_, silicone], stage.along)
    radius = round(stage.pinch.first.radius / stage.along.pixel)
    cv2.circle(picture, _pixel(stage.along, np.zeros(3)), radius, FINGER_COLOURS[0], 2, cv2.LINE_AA)
    centre = object_.place + object_.rotation @ np.array(stage.pinch.body.centre)
    draw_mass(picture, _pixel(stage.along, centre))
    _, turn = stage.pinch.hand.at(now.state.time)
    _draw_down(picture, stage.along, turn.T @ DOWN)
    return picture


def draw_mass(picture: Image, at: tuple[int, int]) -> None:
    """Mark a centre of mass: a disc with two dark quarters."""
    cv2.circle(picture, at, 6, (255, 255, 255), -1, cv2.LINE_AA)
    for start in (0, 180):
        cv2.ellipse(picture, at, (6, 6), 0.0, start, start + 90, (0, 0, 0), -1, cv2.LINE_AA)
    cv2.circle(picture, at, 6, (0, 0, 0), 1, cv2.LINE_AA)


def _now(stage: Stage, now: Pinched, hand: tuple[Array, Array]) -> list[Body]:
    """Object and fingers at an instant, with the hand in a given pose."""
    state = now.state
    place = state.first.place + stage.bases[0] + state.closing * AXIS
    its = (place, state.first.rotation)
    return _posed(stage.pinch, stage.bases, hand, state.closing, its)


def _posed(
    pinch: Pinch,
    base: tuple[Array, Array],
    hand: tuple[Array, Array],
    closing: float,
    its: tuple[Array, Array] | None = None,
) -> list[Body]:
    """Object, then silicone and housing of each finger, in the world.

    Parameters
    ----------
    pinch: pinch that is shown
    base: origins of the fingertips in the hand [m]
    hand: place [m] and rotation of the hand
    closing: distance that each finger closed [m]
    its: place [m] and rotation of the object in the hand (default: those at the start)
    """
    origin, turn = hand
    start = rotation_by(np.array(pinch.turned))
    place, rotation = its or (np.array([*pinch.beside, 0.0]), start)
    bodies = [
        Body(
            shape=pinch.solid.shape, place=origin + turn @ place, rotation=turn @ rotation,
            colour=(214, 150, 60), above=start.T @ -DOWN, other=(250, 214, 130),
        )
    ]  # fmt: skip
    # Turns a shape's own y axis along −z.
    standing = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    for k, dome in enumerate((pinch.first, pinch.second)):
        facing = np.diag(FACING) if k else np.eye(3)
        inwards = facing @ AXIS
        middle = origin + turn @ (base[k] + closing * inwards)
        for shape, depth, colour in _parts(dome, FINGER_COLOURS[k]):
            bodies.append(
                Body(
                    shape=shape, place=middle - depth * (turn @ inwards),
                    rotation=turn @ facing @ standing, colour=colour,
                )
            )  # fmt: skip
    return bodies


#: Shape of the silicone of each body, and its depth below the fingertip's origin [m].
_SILICONE: dict[type[SoftBody], Callable[[SoftBody], tuple[Shape, float]]] = {
    Dome: lambda dome: (ball(dome.radius), 0.0),
    Pad: lambda pad: (
        box((2 * pad.radius, pad.thickness, 2 * pad.radius)),
        0.5 * pad.thickness,
    ),
}


def _parts(dome: SoftBody, colour: Colour) -> tuple[tuple[Shape, float, Colour], ...]:
    """Shapes of silicone and housing, with their depth below the fingertip's origin [m]."""
    radius = dome.radius
    silicone, below = _SILICONE[type(dome)](dome)
    housing_length = 1.1  # length of a finger's housing, as a share of its radius
    length = housing_length * radius
    housing = cylinder(1.02 * radius, length, 0.02 * radius)
    return (silicone, below, colour), (housing, 2 * below + 0.5 * length, (85, 88, 95))


def _table(pinch: Pinch, start: Body) -> Body:
    """Slab right below the object at the start, narrow enough for the fingers."""
    thickness, border = 6e-3, 2e-3  # of the table, and around the object [m]
    y, z = np.ptp(start.corners[:, 1:], axis=0) + 2.0 * border
    # Turned so that the world's x is the shape's z, which `reach_down` measures.
    low = reach_down(start.shape, np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]) @ start.rotation)
    place = start.place + (low + 0.5 * thickness) * DOWN
    return Body(shape=box((thickness, y, z)), place=place, rotation=np.eye(3), colour=TABLE)


def _reach(shape: Shape) -> float:
    return float(np.linalg.norm(np.abs(shape.bounds).max(axis=0)))


def _holding(points: Array, size: tuple[int, int]) -> Viewpoint:
    """Viewpoint in front of the pinch that shows all points and the scale at the left."""
    view_angle = 0.3  # angle of the view downwards [rad]
    guess = look_from(np.zeros(3), AXIS, -DOWN, above=view_angle, size=size, span=1.0)
    across, up = points @ guess.right, points @ guess.up
    width, height = size[0] - _SCALE, size[1]
    free_border = 0.06  # free border around the path, as a share of the picture
    pixel = max(np.ptp(across) / width, np.ptp(up) / height) / (1.0 - 2.0 * free_border)
    middle = 0.5 * (across.min() + across.max()) - 0.5 * _SCALE * pixel
    return Viewpoint(
        middle=middle * guess.right + 0.5 * (up.min() + up.max()) * guess.up,
        right=guess.right, up=guess.up, width=size[0], height=size[1], pixel=float(pixel),
    )  # fmt: skip


def _draw_heights(picture: Image, stage: Stage, centre: Array) -> None:
    """Draw the scale of the rise of the centre of mass since the start, with a mark at it."""
    view, high = stage.side, view_height(stage)
    step = next(s for s in (5, 10, 20, 50, 100, 200, 500, 1000, 10_000) if high <= 6 * s)
    for rise in range(0, high + 1, step):
        row = _pixel(view, stage.start - 1e-3 * rise * DOWN)[1]
        if not 0 <= row < view.height:
            continue
        cv2.line(picture, (_SCALE, row), (_SCALE + 6, row), INK, 1, cv2.LINE_AA)
        text = f"{rise}"
        at = (_SCALE - 4 - 8 * len(text), row + 4)
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.4, INK, 1, cv2.LINE_AA)
        if rise == 0:
            bottom = row
        top = row
    cv2.line(picture, (_SCALE, bottom), (_SCALE, top), INK, 1, cv2.LINE_AA)
    cv2.putText(
        picture, "mm", (_SCALE - 10, top - 12), cv2.FONT_HERSHEY_SIMPLEX, 0.4, INK, 1, cv2.LINE_AA
    )
    column, row = _pixel(view, centre)
    cv2.line(picture, (_SCALE + 8, row), (column, row), (150, 150, 150), 1, cv2.LINE_AA)
    tip = np.array([[_SCALE + 2, row], [_SCALE + 11, row - 5], [_SCALE + 11, row + 5]], np.int32)
    cv2.fillPoly(picture, [tip], INK, cv2.LINE_AA)
    draw_mass(picture, (column, row))


def view_height(stage: Stage) -> int:
    """Largest height above the start on the scale [mm]."""
    view = stage.side
    start = _pixel(view, stage.start)[1]
    one = start - _pixel(view, stage.start - 1.0 * DOWN)[1]  # pixels of a metre
    return max(int(1e3 * (start - 30) / one), 1)


def _draw_down(picture: Image, view: Viewpoint, down: Array) -> None:
    """Draw an arrow along gravity in a corner; it is short if gravity is along the view."""
    start = np.array([20.0, 16.0])
    along = np.array([down @ view.right, -(down @ view.up)])
    a, b = (tuple(int(v) for v in np.rint(p)) for p in (start, start + 28.0 * along))
    cv2.arrowedLine(picture, a, b, INK, 2, cv2.LINE_AA, tipLength=0.3)
    cv2.putText(picture, "g", (30, 34), cv2.FONT_HERSHEY_SIMPLEX, 0.45, INK, 1, cv2.LINE_AA)


def _pixel(view: Viewpoint, point: Array) -> tuple[int, int]:
    x, y = np.rint(view.project(point))
    return int(x), int(y)
