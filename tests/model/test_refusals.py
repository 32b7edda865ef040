"""What no body, object, motion or drive can be is one sentence that names it."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from chromagrip.errors import UserError
from chromagrip.model import (
    ContactObject,
    Dome,
    Drive,
    Fingertip,
    LostContactError,
    ModelError,
    Motion,
    NoEquilibriumError,
    Pad,
    PiercedError,
    Solid,
    dome_forces,
    equilibrium,
    press_and_move,
    rest_state,
    shapes,
    simulate,
    simulate_contact,
    step,
)
from chromagrip.model.dome import resting
from chromagrip.model.pinch import Filling, Pinch, Shake, box_body
from chromagrip.model.shapes import plane

NAN, TIP, OBJ, PLATE = math.nan, Fingertip(nodes=21), ContactObject(), Solid(shape=plane())
COARSE = Dome(pitch=0.7e-3, reach=math.radians(45.0))
STILL, DEEP = np.zeros((2, 6)), [0.0, 0.0, 1e-4, 0.0, 0.0, 0.0]
POINT = {"times": [0.0, 1.0], "normal": [1.0, 1.0], "lateral": [0, 0]}


def run(drive: Drive, obj: ContactObject = OBJ, **changes: float) -> object:
    return simulate(TIP, obj, drive, **{"dt": 1e-3, "duration": 0.01} | changes)  # type: ignore[arg-type]


def drive(**changes: Any) -> Drive:
    return Drive(**POINT | changes)


def over(motion: Motion, solid: Any = Solid(shape=plane(), stiffness=1e11)) -> object:  # noqa: B008
    return simulate_contact(COARSE, solid, motion, 5e-3)


def pinch(**changes: Any) -> Pinch:
    solid, body = Solid(shape=shapes.box(0.02)), box_body(0.05, (0.02, 0.02, 0.02))
    return Pinch(**{"first": COARSE, "second": COARSE, "solid": solid, "body": body} | changes)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        # chains
        (lambda: Fingertip(nodes=250), "must be odd"),
        (lambda: Fingertip(law="rubber"), "law must be one of split, inverse-poisson, axial"),
        (lambda: Fingertip(nodes=11, stations=(0.0,) * 11), "increase from 0 to 1"),
        (lambda: Fingertip(radius=0.0), "radius must be finite and above 0 m, got 0.0"),
        (lambda: Fingertip.graded(61, 6e-3), "graded fingertip nodes must be odd and in"),
        # objects of a chain
        (lambda: ContactObject(stiffness=1e300), r"above 0 and at most 1e\+09 N/m, got 1e\+300"),
        (lambda: ContactObject(friction=NAN), "friction coefficient .* got nan"),
        (lambda: ContactObject(curvature=1e6), "object curvature must lie in -1000…1000 1/m"),
        (lambda: ContactObject(surface="rolls"), "surface must be one of travels, stays"),  # type: ignore[arg-type]
        (lambda: ContactObject(profile=((0, 0), (1, 0), (1, 1))), "increasing x"),
        (lambda: ContactObject(patches=((3.0, 1.0),)), "place of an object patch must lie in"),
        (lambda: ContactObject(patches=((1e-3, 1.0), (0.0, 2.0))), "patches must have increas"),
        # runs of a chain
        (lambda: drive(normal=[1.0]), "as many values as times"),
        (lambda: drive(normal_control="speed"), "must be force or position, got 'speed'"),
        (lambda: run(drive(), dt=3e-3), "whole number of recorded steps"),
        (lambda: step(TIP, OBJ, rest_state(TIP), 0.0, 1.0, 0.0), "dt > 0"),
        (
            lambda: equilibrium(TIP, ContactObject(curvature=-200.0), 1.0),
            r"curvature -200\.0 1/m is a hollow of 0\.005 m radius",
        ),
        # silicone
        (lambda: Dome(radius=-1.0), "dome radius"),
        (lambda: Dome(core=9e-3), "dome core"),
        (lambda: Dome(young=NAN), "Young's modulus"),
        (lambda: Pad(thickness=30e-3), "thickness of the pad"),
        (lambda: Pad(poisson=0.5), "Poisson"),
        # shapes
        (lambda: shapes.box((1e-2, 1e-2), 0.0), "must be one edge or three"),  # type: ignore[arg-type]
        (lambda: shapes.box(1e-2, 6e-3), "rounding of a box must lie in 0…0.005 m"),
        (lambda: shapes.capsule(5e-3, 8e-3), "length of a capsule must lie in 0.01…10 m"),
        (lambda: shapes.torus(2e-3, 3e-3), "tube of a torus"),
        (lambda: shapes.cone(4e-3, 8e-3, 3e-3), "rounding of a cone"),
        # motions over silicone
        (lambda: Motion(times=[0.0, 0.0], poses=STILL), "increasing"),
        (lambda: Motion(times=[0.0, 0.1], poses=np.zeros((3, 6))), "shape"),
        (lambda: Motion(times=[0.0, 0.1], poses=STILL, free=("x",)), "mass or drag"),
        (lambda: over(press_and_move(1e-4), plane()), "touched by a Solid"),
        (
            lambda: over(Motion(times=[0.0, 0.1], poses=STILL - DEEP)),
            "inside the skin at the start",
        ),
        (lambda: over(press_and_move(1.9e-3)), "of the silicone"),
        # two fingers
        (lambda: pinch(drag=0.0), "drag of the drive"),
        (lambda: pinch(gravity=(0.0, 0.0, 0.0)), "stands on no table"),
        (lambda: pinch(solid=PLATE), "object with an end"),
        (lambda: Filling(times=(0.0, 1.0), masses=(0.1,)), "2 times and 1 masses"),
        (lambda: Filling(times=(1.0, 0.5), masses=(0.0, 0.1)), "must increase"),
        (lambda: Shake(amplitude=(0, 0, 0), frequency=5.0, start=0.0, stop=0.3), "two periods"),
    ],
)
def test_what_cannot_be_is_refused(make: Callable[[], object], words: str) -> None:
    with pytest.raises(UserError, match=words):
        make()


@pytest.mark.parametrize(
    ("make", "kind", "words"),
    [
        (
            lambda: run(Drive.constant(0.0, 0.5), duration=1e-3),
            LostContactError, r"load of 0\.5 N at t = 0\.001 s",
        ),
        (
            lambda: run(
                Drive.constant(30.0), ContactObject(stiffness=80.0, curvature=200.0), duration=0.5
            ),
            PiercedError, "went through the object",
        ),
        (
            lambda: equilibrium(TIP, OBJ, 1.0, 0.65),
            NoEquilibriumError, r"friction 0\.5 under a grip of 1 N",
        ),
        (
            lambda: equilibrium(TIP, ContactObject(stiffness=80.0, curvature=200.0), 30.0),
            PiercedError, "too soft and too sharp",
        ),
    ],
)  # fmt: skip
def test_where_a_run_cannot_go_on_it_says_why(
    make: Callable[[], object], kind: type[ModelError], words: str
) -> None:
    with pytest.raises(kind, match=words):
        make()


def test_a_state_of_another_dome_is_refused() -> None:
    """Its nodes are others: a kernel would read beyond the end of its arrays."""
    motion = press_and_move(1e-4)
    state = resting(Dome(pitch=0.8e-3), PLATE, motion)
    for use in (
        lambda: simulate_contact(COARSE, PLATE, motion, dt=0.1, start=state),
        lambda: dome_forces(COARSE, state),
    ):
        with pytest.raises(UserError, match=r"of a dome with \d+ nodes"):
            use()
