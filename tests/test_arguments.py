"""Arguments of a method by name: what is missing, unknown or of another type is one sentence."""

import re
import sys
from functools import partial
from typing import Any, Literal

import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.arguments import check_arguments, check_complete
from chromagrip.outside.gripper import GRIPPERS
from chromagrip.sources import open_source
from chromagrip.tracking import load_tracker


class Mine:
    """A tracker, a source and a gripper; one type cannot be found."""

    def __init__(
        self, serial: str, gain: float, *, free: Any = None,
        later: "Unknown" = None,  # type: ignore[name-defined]  # noqa: F821
    ) -> None: ...  # fmt: skip
    def reset(self, rest: object) -> None: ...
    def update(self, frame: object) -> None: ...
    def read(self) -> None: ...
    def command(self, force: float) -> None: ...


class Typed:
    """Types that can all be found."""

    def __init__(
        self, serial: str, gain: float, *, mode: Literal["fast", "safe"] = "safe",
        unit: int | None = None, floor: bool = False, places: tuple[float, ...] = (),
    ) -> None: ...  # fmt: skip
    def command(self, force: float) -> None: ...


@pytest.fixture(autouse=True)
def _importable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mine", sys.modules[__name__])


NEEDS = (
    "gripper 'mine:Typed' needs serial (a text in quotes) and gain (a number); it has "
    "serial, gain, mode, unit, floor"
)


@pytest.mark.parametrize(
    ("name", "arguments", "sentence"),
    [
        ("mine:Typed", {}, NEEDS),
        ("mine:Typed", {"flor": True}, "gripper 'mine:Typed' has no argument flor (did you"),
        ("mine:Mine(serial=a)", {}, "gripper 'mine:Mine(serial=a)' needs gain (a number); it has"),
    ],
)
def test_a_gripper_tells_what_it_needs(name: str, arguments: dict[str, Any], sentence: str) -> None:
    with pytest.raises(UserError, match=f"^{re.escape(sentence)}"):
        GRIPPERS.build(name, arguments)


def test_so_do_sources_and_trackers() -> None:
    with pytest.raises(UserError, match=r"^source 'mine:Typed' has no read; see"):
        open_source("mine:Typed")
    with pytest.raises(UserError, match=r"^source 'mine:Mine' needs serial \(a text in quotes\)"):
        list(open_source("mine:Mine").frames())
    # A tracker gets two arguments, a palette and the noise, before those of its own.
    with pytest.raises(UserError, match=r"^tracker 'mine:Third' needs floor \(true or false\)"):
        load_tracker("mine:Third")
    assert load_tracker("mine:Third(floor=true)")(None, 1.0).floor  # type: ignore[arg-type, attr-defined]
    with pytest.raises(UserError, match=r"^tracker 'mine:Third' has no argument noise; it has flo"):
        load_tracker("mine:Third(noise=1.0)")


class Third(Mine):
    def __init__(self, palette: object, noise: float, floor: bool) -> None:
        self.floor = floor


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("serial", 12.5, "a text in quotes"),
        ("gain", 2, ""),
        ("mode", "fast", ""),
        ("gain", True, "a number"),
        ("mode", "quick", "fast or safe"),
        ("unit", 9.5, "a whole number"),
        ("floor", 1, "true or false"),
        ("places", "here", ""),  # what is allowed there is not known
        ("gain", np.float32(2.0), ""),  # from Python
    ],
)
def test_types_of_values(name: str, value: object, expected: str) -> None:
    if not expected:
        check_arguments("gripper 'x'", Typed, {name: value})
        return
    words = re.escape(f"gripper 'x': {name} = {value!r}; expected {expected}")
    with pytest.raises(UserError, match=f"^{words}$"):
        check_arguments("gripper 'x'", Typed, {name: value})


def test_types_that_cannot_be_found_are_not_checked() -> None:
    check_arguments("gripper 'x'", Mine, {"serial": "a", "later": 1, "free": "all"})
    with pytest.raises(UserError, match="serial = 3; expected a text"):
        check_arguments("gripper 'x'", Mine, {"serial": 3})


def test_what_a_factory_has_is_not_missing() -> None:
    check_complete("x", partial(Typed, serial="a", gain=1.0))
    check_complete("x", lambda *several, **named: None)
    check_complete("x", dict)
    with pytest.raises(UserError, match=r"^x needs gain"):
        check_complete("x", partial(Typed, serial="a"))
