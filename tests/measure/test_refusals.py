"""What the studies, `limit` and `reproduce` refuse, each in a sentence."""

import math
from dataclasses import replace
from typing import Any

import pytest

from chromagrip.cli.limit import limit
from chromagrip.cli.measure import reproduce
from chromagrip.errors import UserError
from chromagrip.measure.engine import measure
from chromagrip.measure.limits.dome.held import Grip, hold
from chromagrip.measure.limits.forces import press
from chromagrip.measure.study import Asked
from chromagrip.model import ContactObject, Fingertip
from chromagrip.render import load_sensor


@pytest.mark.parametrize(
    ("verb", "part", "asked", "words"),
    [
        ("bench", "control", Asked(methods=("pid",)), "pid"),
        ("bench", "control", Asked(methods=("mine",), world="pinch"), "no controller 'mine'"),
        ("bench", "track", Asked(methods=("nobody",)), "no tracker 'nobody'; there is"),
        ("bench", "track", Asked(only=("sea",)), "has no scene 'sea'; there is clean, "),
        ("bench", "force", Asked(methods=("nobody",)), "no reconstructor 'nobody'"),
        ("bench", "force", Asked(world="outer"), "no world 'outer'; there is matched, "),
        ("bench", "force", Asked(world="dome", only=("roll",)), "has no group 'roll'; there is"),
        ("bench", "force", Asked(world="beyond", only=("rolls",)), "did you mean roll"),
        ("bench", "nothing", Asked(), "no bench 'nothing'; there is"),
        ("chart", "force", Asked(methods=("nobody",)), "no reconstructor 'nobody'"),
    ],
)
def test_a_study_refuses_what_it_lacks(verb: str, part: str, asked: Asked, words: str) -> None:
    with pytest.raises(UserError, match=words):
        measure(verb, part, asked)


DOME: dict[str, Any] = {"body": "dome", "sensor": ("dome-2020",)}


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"sensor": ("flat-2019",)}, "flat pad"),
        ({"sensor": ("dome-2020-printed",)}, "stiff discs only"),
        ({"sensor": ("nothing",)}, "no sensor design"),
        ({"noise": 0.0}, "--noise must be finite and above 0"),
        ({"margin_error": -0.1}, "--margin-error must be finite and above 0"),
        ({"frames": 0}, "--frames must be 1 or more"),
        ({"load": 2.0}, "must hold a load of 2 N"),
        ({"radius_mm": 0.2}, "radius_mm"),
        ({"shears": 2}, "--shears needs --body dome"),
        ({"azimuth_deg": 10.0}, "--azimuth-deg needs --body dome"),
        ({**DOME, "sensor": ("flat-2019",)}, "limit --body dome needs a dome of silicone"),
        ({**DOME, "shears": 0}, "--shears must be 1 to 20, got 0"),
        ({**DOME, "friction": 0.0}, "--friction must be above 0"),
        ({**DOME, "radius_mm": -5.0}, "--radius-mm must be above 0"),
        ({**DOME, "stiffness_kpa": 0.0}, "--stiffness-kpa must be above 0"),
        ({**DOME, "azimuth_deg": math.inf}, "--azimuth-deg must be finite"),
        ({**DOME, "load": 2.0}, "sensor dome-2020: a grip of 3 N must hold"),
    ],
)
def test_the_command_limit_refuses_what_cannot_be(asked: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError, match=words):
        limit(**asked)


@pytest.mark.parametrize("grip", [0.0, 1.3, math.nan, math.inf])
def test_a_contact_that_cannot_be_is_refused(grip: float) -> None:
    with pytest.raises(UserError, match=r"must hold a load of 0\.65 N|press the whole"):
        press(Fingertip(), ContactObject(), grip, 0.65)
    with pytest.raises(UserError, match=r"must hold a load of 0\.65 N"):
        hold(load_sensor("dome-2020").dome, Grip(normal=grip, load=0.65))


def test_a_grip_that_a_dome_cannot_bear_is_refused() -> None:
    dome = replace(load_sensor("dome-2020").dome, pitch=1.6e-3)
    with pytest.raises(UserError, match=r"of radius 2 mm is sharper .*: 2\.5 mm or more"):
        hold(dome, Grip(normal=3.0, load=1.05, radius=2e-3))
    with pytest.raises(UserError, match="a dome of 20 mm cannot hold 2000 N"):
        hold(dome, Grip(normal=2000.0, load=1.05))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"part": "figure-9", "camera": "thesis"}, "--camera is an option of all, table-2"),
        ({"part": "appendix-b", "quick": True}, "neither a camera nor a quick run"),
        ({"part": "figure-9", "workers": 0}, "--workers 0: expected 1 or more"),
    ],
)
def test_options_of_reproduce_that_do_not_go_together(
    arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(UserError, match=message):
        reproduce(**arguments)
