"""The Franka Hand, through a fake of the package franky."""

import sys
import time
from types import ModuleType

import pytest

from chromagrip import UserError
from chromagrip.outside.gripper import GRIPPERS, HeldGripper


class Future:
    """A motion; it ends when a test gives its result."""

    def __init__(self) -> None:
        self.result: bool | Exception | None = None

    def wait(self, timeout: float | None = None) -> bool:
        assert timeout == 0.0, "the loop would wait"
        return self.result is not None

    def get(self) -> bool:
        assert self.result is not None
        if isinstance(self.result, Exception):
            raise self.result
        return self.result


class NetworkException(Exception):  # noqa: N818
    """The one of franky has no other base."""


class FakeHand:
    """Names and order of arguments as in the stub of franky-control 2.0."""

    asked: list[tuple[str, tuple[float, ...]]]
    tasks: list[Future]

    def __init__(self, fci_hostname: str) -> None:
        if fci_hostname == "nowhere":
            raise NetworkException("libfranka gripper: Connection timeout")
        FakeHand.asked, FakeHand.tasks = [], []

    def grasp_async(
        self,
        width: float,
        speed: float,
        force: float,
        epsilon_inner: float = 0.005,
        epsilon_outer: float = 0.005,
    ) -> Future:
        return self._begin("grasp", width, speed, force, epsilon_inner, epsilon_outer)

    def stop_async(self) -> Future:
        return self._begin("stop")

    def _begin(self, name: str, *arguments: float) -> Future:
        self.asked.append((name, arguments))
        self.tasks.append(Future())
        return self.tasks[-1]


@pytest.fixture(autouse=True)
def franky(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("franky")
    module.__dict__["Gripper"] = FakeHand
    monkeypatch.setitem(sys.modules, "franky", module)


def hand(**arguments: object) -> HeldGripper:
    made = GRIPPERS.build("franka", {"host": "172.16.0.2"} | arguments)
    return HeldGripper(made, "franka", 5.0)


def forces() -> list[float]:
    return [arguments[2] for name, arguments in FakeHand.asked if name == "grasp"]


def test_the_newest_force_is_grasped_with_after_each_motion() -> None:
    gripper = hand(speed=0.05)
    gripper.command(0.0, "first")
    assert FakeHand.asked == []
    for force in (30.2, 35.0, 40.0):
        gripper.command(force, "under way")
    # Fingers closed as far as they go, and every width of an object within the travel of 80 mm.
    assert FakeHand.asked == [("grasp", (0.0, 0.05, 30, 0.1, 0.1))]
    FakeHand.tasks[-1].result = True
    for force in (45.0, 45.4):
        gripper.command(force, "after it")
    assert forces() == [30, 45]
    FakeHand.tasks[-1].result = True
    gripper.command(45.4, "the same newton")
    assert forces() == [30, 45]


def test_0_n_stops_also_under_way() -> None:
    gripper = hand()
    gripper.command(50.0, "at once")
    gripper.command(0.0, "at once")
    gripper.command(0.0, "at once")
    assert [name for name, _ in FakeHand.asked] == ["grasp", "stop"]
    FakeHand.tasks[-1].result = True
    gripper.command(50.0, "again")
    assert forces() == [50, 50]


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (False, "was refused"),
        (NetworkException("connection lost"), "failed: connection lost"),
    ],
)
def test_a_grasp_that_fails_is_one_sentence_and_is_not_tried_again(
    result: bool | Exception, words: str
) -> None:
    gripper = hand()
    gripper.command(40.0, "first")
    FakeHand.tasks[-1].result = True
    gripper.command(60.0, "second")
    FakeHand.tasks[-1].result = result
    sentence = (
        f"^gripper franka failed at the third: hand at 172.16.0.2: the grasp with 60 N {words}; "
        "the grip stays at 40 N$"
    )
    with pytest.raises(UserError, match=sentence):
        gripper.command(65.0, "at the third")
    gripper.hold()
    assert forces() == [40, 60]


def test_a_grasp_that_does_not_end_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    gripper = hand(speed=0.04)
    gripper.command(40.0, "first")
    begin = time.monotonic()
    monkeypatch.setattr("chromagrip.outside.franka.monotonic", lambda: begin + 6.9)
    gripper.command(50.0, "0.08 m at 0.04 m/s take 2 s, and 5 s are allowed more")
    monkeypatch.setattr("chromagrip.outside.franka.monotonic", lambda: begin + 7.1)
    with pytest.raises(UserError, match="the grasp with 40 N does not end; the grip stays at 0 N"):
        gripper.command(50.0, "late")


def test_what_the_hand_cannot_do_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UserError, match=r"cannot hold 2 N: it closes with 30 to 70 N; floor=true"):
        hand().command(2.0, "at once")
    with pytest.raises(UserError, match=r"cannot hold 71 N: it closes with 30 to 70 N$"):
        hand().command(71.0, "at once")
    hand(floor=True).command(2.0, "at once")
    assert forces() == [30]
    with pytest.raises(UserError, match=r"^gripper 'franka' cannot be made .*Connection timeout"):
        hand(host="nowhere")
    with pytest.raises(UserError, match="speed 0: expected more than 0"):
        hand(speed=0)
    monkeypatch.setitem(sys.modules, "franky", None)
    with pytest.raises(UserError, match="needs the package franky: pip install franky-control"):
        hand()
