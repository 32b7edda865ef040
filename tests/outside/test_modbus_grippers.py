"""Robotiq's and OnRobot's grippers, against fake devices that answer as the manuals print it."""

import json
import os
import re
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from subprocess import CompletedProcess

import cv2
import pytest

import chromagrip
from chromagrip import UserError, load_scene
from chromagrip.control import GripCommand, GripObservation
from chromagrip.loop import open_camera
from chromagrip.outside.grasp import run_outside
from chromagrip.outside.gripper import GRIPPERS, HeldGripper
from chromagrip.outside.modbus_grippers import OnRobot, Robotiq

Typed = Callable[..., CompletedProcess[str]]
ACTIVE = 0x3100


class Device:
    """A Modbus TCP device on the loopback interface, with registers that a test sets.

    `written` has each write in order, `asked` every request without its number, and `answer` may
    replace an answer: by other bytes, by None for silence, or by `b""` to close the connection.
    """

    def __init__(self, registers: dict[int, int]) -> None:
        self.registers = registers
        self.written: list[tuple[int, list[int]]] = []
        self.asked: list[bytes] = []
        self.connections = 0
        self.answer: Callable[[bytes, bytes], bytes | None] = lambda asked, usual: usual
        self._server = socket.create_server(("127.0.0.1", 0))
        self.host = f"127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            self.connections += 1
            threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection:
            while head := connection.recv(6):
                number, _, length = struct.unpack(">HHH", head)
                asked = connection.recv(length)
                self.asked.append(asked)
                answer = self.answer(asked, bytes([asked[0]]) + self.usual(asked[1:]))
                if answer == b"":
                    return
                if answer is not None:
                    connection.sendall(struct.pack(">HHH", number, 0, len(answer)) + answer)

    def usual(self, asked: bytes) -> bytes:
        kind, first, count = struct.unpack(">BHH", asked[:5])
        if kind == 16:
            values = [*struct.unpack(f">{count}H", asked[6:])]
            self.written.append((first, values))
            self.wrote(first, values)
            return asked[:5]
        words = [self.registers[first + k] for k in range(count)]
        return struct.pack(f">BB{count}H", kind, 2 * count, *words)

    def wrote(self, first: int, values: list[int]) -> None:
        pass

    def close(self) -> None:
        self._server.close()


class FakeRobotiq(Device):
    """It is activated by the second of two reads after rACT rises."""

    def __init__(self, status: int = ACTIVE) -> None:
        super().__init__({0: status, 1: 0, 2: 0})

    def wrote(self, first: int, values: list[int]) -> None:
        active = values[0] & 0x0100
        self.registers[0] = self.registers[0] & 0x3000 | values[0] if active else 0

    def usual(self, asked: bytes) -> bytes:
        answer = super().usual(asked)
        if asked[0] == 4 and self.registers[0] & 0x0100 and not self.registers[0] & 0x2000:
            self.registers[0] += 0x1000 if not self.registers[0] & 0x1000 else 0x2000
        return answer


class FakeOnRobot(Device):
    def __init__(self) -> None:
        super().__init__({268: 0})


@pytest.fixture
def robotiq() -> Iterator[FakeRobotiq]:
    device = FakeRobotiq()
    yield device
    device.close()


@pytest.fixture
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """A device must answer within 0.2 s, twice."""
    monkeypatch.setattr("chromagrip.outside.modbus_grippers.ANSWER_S", 0.2)


@pytest.fixture
def onrobot() -> Iterator[FakeOnRobot]:
    device = FakeOnRobot()
    yield device
    device.close()


# Robotiq


@pytest.mark.parametrize(
    ("model", "force", "step"),
    [
        ("2f-85", 20.0, 0),
        ("2f-85", 235.0, 255),
        ("2f-85", 63.0, 51),  # a fifth of 215 N above 20 N, and of 255 steps
        ("2f-140", 10.0, 0),
        ("2f-140", 56.0, 102),
        ("2f-140", 125.0, 255),
        ("hand-e", 119.0, 153),
        ("hand-e", 185.0, 255),
    ],
)
def test_the_force_is_its_share_of_the_models_range(
    model: str, force: float, step: int, robotiq: FakeRobotiq
) -> None:
    Robotiq(model, host=robotiq.host, speed=0.2).command(force)
    assert robotiq.written == [(0, [0x0900, 0x00FF, 51 * 256 + step])]


def test_the_controller_is_asked_as_the_manual_prints_it() -> None:
    """Section 4.10.4 of the manual of the 2-Finger 200; three registers of the status are read."""
    device = FakeRobotiq(status=0)
    gripper = Robotiq("2f-85", host=device.host, speed=1.0)
    clear, activate = "02 10 0000 0003 06 0000 0000 0000", "02 10 0000 0003 06 0100 0000 0000"
    status = "02 04 0000 0003"
    assert device.asked == [*map(bytes.fromhex, (status, clear, activate, status, status, status))]
    gripper.command(235.0)
    assert device.asked[-1] == bytes.fromhex("02 10 0000 0003 06 0900 00FF FFFF")
    device.close()


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
def test_the_serial_line_has_the_frames_of_the_manual() -> None:
    """Frames of chapter 4 of the manuals of 2F-85 & 2F-140 and of Hand-E, with their checksums."""
    pytest.importorskip("serial")
    import tty

    status, wrote = "09 04 07 D0 00 03 B1 CE", "09 10 03 E8 00 03 01 30"
    script = [
        (status, "09 04 06 00 00 00 00 00 00 07 53"),
        ("09 10 03 E8 00 03 06 00 00 00 00 00 00 73 30", wrote),
        ("09 10 03 E8 00 03 06 01 00 00 00 00 00 72 E1", wrote),
        (status, "09 04 06 39 00 00 00 BB 10 71 06"),
        (status, "09 04 06 39 00 00 00 BB 10 71 06"),
        ("09 10 03 E8 00 03 06 09 00 00 FF FF FF 42 29", wrote),
        (status, "09 04 06 B9 00 00 FF BD 00 5C 9A"),
    ]
    ours, line = os.openpty()
    for end in (ours, line):
        tty.setraw(end)
    asked = []

    def serve() -> None:
        for request, answer in script:
            size = len(bytes.fromhex(request))
            got = b""
            while len(got) < size:
                got += os.read(ours, size - len(got))
            asked.append(got)
            os.write(ours, bytes.fromhex(answer))

    server = threading.Thread(target=serve, daemon=True)
    server.start()
    gripper = Robotiq("2f-85", port=os.ttyname(line), speed=1.0)
    gripper.command(235.0)
    gripper.command(235.0)
    server.join(5.0)
    assert asked == [bytes.fromhex(request) for request, _ in script]
    del gripper
    os.close(ours)
    os.close(line)


def test_a_port_that_is_not_there_is_refused() -> None:
    pytest.importorskip("serial")
    with pytest.raises(UserError, match=r"^2f-85 at /nowhere/tty cannot be reached: .*No such fil"):
        Robotiq("2f-85", port="/nowhere/tty")


def test_the_same_step_is_sent_once_and_0_n_stops_the_fingers(robotiq: FakeRobotiq) -> None:
    gripper = Robotiq("2f-85", host=robotiq.host)
    for force in (0.0, 0.0, 30.0, 30.3, 31.0, 0.0):
        gripper.command(force)
    stop, steps = [0x0100, 0, 0], (12, 13)
    closing = [[0x0900, 0x00FF, step] for step in steps]  # 10 and 11 of 215 N are 11.9 and 13.0
    assert [values for _, values in robotiq.written] == [stop, *closing, stop]
    assert sum(asked[1] == 4 for asked in robotiq.asked) == 1 + 6  # faults are always looked for


def test_a_force_that_cannot_be_held_is_refused_or_raised_where_that_is_asked(
    robotiq: FakeRobotiq,
) -> None:
    gripper = Robotiq("2f-85", host=robotiq.host)
    words = "cannot hold 1.2 N: it closes with 20 to 235 N; floor=true closes with 20 N for less"
    with pytest.raises(UserError, match=f"^2f-85 at {robotiq.host} {re.escape(words)}$"):
        gripper.command(1.2)
    for force in (236.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(UserError, match=r"it closes with 20 to 235 N$"):
            gripper.command(force)
    assert robotiq.written == []
    raised = Robotiq("2f-85", host=robotiq.host, floor=True)
    for force in (0.0, 0.5, 19.9):  # a ramp
        raised.command(force)
    assert [values[0] for _, values in robotiq.written] == [0x0100, 0x0900]
    assert robotiq.written[-1][1][2] & 0xFF == 0
    with pytest.raises(UserError, match=r"cannot hold 236 N: it closes with 20 to 235 N$"):
        raised.command(236.0)
    with pytest.raises(UserError, match=r"cannot hold 1 N: .*; floor=true closes with 20 N"):
        GRIPPERS.build("robotiq", {"model": "2f-85", "host": robotiq.host}).command(1)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (0x08, "fault 8: it is too hot"),
        (0x0E, "fault 14: its current is too high"),
        (0x3D, "fault 13: its activation failed"),  # the upper half belongs to a controller
        (0x06, "fault 6: see its manual"),
    ],
)
def test_a_fault_is_reported_and_nothing_is_sent(
    fault: int, words: str, robotiq: FakeRobotiq
) -> None:
    gripper = Robotiq("2f-85", host=robotiq.host)
    gripper.command(30.0)
    robotiq.registers[1] = fault << 8 | 0xFF
    for _ in range(2):
        with pytest.raises(UserError, match=f"^2f-85 at {robotiq.host} reports {words}$"):
            gripper.command(40.0)
    with pytest.raises(UserError, match=f"reports {words}$"):
        Robotiq("2f-85", host=robotiq.host)
    assert len(robotiq.written) == 1
    robotiq.registers[1] = 0x0900  # no request for a second: a slow loop, not a fault
    gripper.command(30.0)
    assert robotiq.written[1] == robotiq.written[0]


def test_a_gripper_that_was_switched_off_is_not_activated_under_way(robotiq: FakeRobotiq) -> None:
    gripper = Robotiq("2f-85", host=robotiq.host)
    robotiq.registers[0] = 0
    with pytest.raises(UserError, match=r"is not activated any more$"):
        gripper.command(30.0)
    assert robotiq.written == []


def test_an_activation_that_does_not_end_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("chromagrip.outside.modbus_grippers.MOTION_S", 0.1)
    device = Device({0: 0x1100, 1: 0x0500, 2: 0})
    with pytest.raises(UserError, match=r"was not activated within 0\.1 s$"):
        Robotiq("hand-e", host=device.host)
    device.close()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"host": ""}, "expected either a port, such as /dev/ttyUSB0, or a host"),
        ({"port": "/dev/ttyUSB0"}, "expected either a port"),
        ({"host": "robot:http"}, "host 'robot:http': expected HOST or HOST:PORT"),
        ({"speed": 255}, "speed 255: expected 0 to 1"),
    ],
)
def test_arguments_that_cannot_be_used_are_refused(given: dict[str, object], words: str) -> None:
    arguments = {"model": "2f-85", "host": "127.0.0.1"} | given
    with pytest.raises(UserError, match=f"^gripper 'robotiq' cannot be made with .*: {words}"):
        GRIPPERS.build("robotiq", arguments)


# OnRobot


@pytest.mark.parametrize(
    ("model", "force", "tenths"), [("rg2", 3.0, 30), ("rg2", 12.34, 123), ("rg6", 120.0, 1200)]
)
def test_onrobots_force_is_in_tenths(
    model: str, force: float, tenths: int, onrobot: FakeOnRobot
) -> None:
    gripper = OnRobot(model, onrobot.host)
    gripper.command(force)
    gripper.command(force - 0.001 if force > 100.0 else force + 0.001)
    assert onrobot.written == [(0, [tenths, 0, 16])]
    assert onrobot.asked[0] == bytes.fromhex("41 03 010C 0001")  # device 65, status


def test_a_moving_gripper_gets_the_newest_force_after_its_motion(
    onrobot: FakeOnRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    gripper = OnRobot("rg2", onrobot.host)
    gripper.command(5.0)
    onrobot.registers[268] = 0b01
    for force in (6.0, 7.0):
        gripper.command(force)
    assert [values for _, values in onrobot.written] == [[50, 0, 16]]
    onrobot.registers[268] = 0b10  # an object is gripped
    gripper.command(8.0)
    onrobot.registers[268] = 0b11
    gripper.command(0.0)
    assert [values for _, values in onrobot.written[1:]] == [[80, 0, 16], [0, 0, 8]]
    monkeypatch.setattr("chromagrip.outside.modbus_grippers.MOTION_S", 0.0)
    time.sleep(0.001)
    with pytest.raises(UserError, match=r"has been moving for 0 s$"):
        gripper.command(8.0)


def test_onrobots_refusals(onrobot: FakeOnRobot) -> None:
    gripper = OnRobot("rg6", onrobot.host)
    with pytest.raises(UserError, match=r"cannot hold 20 N: it closes with 25 to 120 N; floor"):
        gripper.command(20.0)
    onrobot.registers[268] = 0b1000
    with pytest.raises(UserError, match=r"reports a safety switch \(status 8\): free its fingers"):
        gripper.command(30.0)
    assert onrobot.written == []
    with pytest.raises(UserError, match="model 'rg4': expected rg2, rg6"):
        OnRobot("rg4", onrobot.host)


# The connection


def test_a_device_that_is_not_there_is_refused() -> None:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # no one listens
        host = f"127.0.0.1:{nobody.getsockname()[1]}"
        with pytest.raises(UserError, match=f"^rg2 at {host} cannot be reached: .*refused$"):
            OnRobot("rg2", host)


@pytest.mark.usefixtures("soon")
@pytest.mark.parametrize(
    ("answer", "words", "connections"),
    [
        (None, "gave no valid answer within 0.4 s", 2),
        (b"A\x7f\xff\xff\xff", "gave no valid answer within 0.4 s", 2),
        (b"B\x03\x02\x00\x00", "gave no valid answer within 0.4 s", 2),
        (b"", "lost the connection", 2),
        (b"A\x83\x02", "answered register 268 with Modbus exception 2", 1),
        (b"A\x03\x04\x00\x00\x00\x00", "answered register 268 with 2 registers", 1),
        (b"A\x03\x00", "answered register 268 with 0 registers", 1),
    ],
    ids=["silence", "another function", "another unit", "closed", "exception", "long", "short"],
)
def test_answers_that_are_none(
    answer: bytes | None, words: str, connections: int, onrobot: FakeOnRobot
) -> None:
    """A late answer to a request that was given up must not be taken for the next one's."""
    gripper = OnRobot("rg2", onrobot.host)
    onrobot.answer = lambda asked, usual: answer
    with pytest.raises(UserError, match=f"^rg2 at {onrobot.host} {words}$"):
        gripper.command(5.0)
    assert len(onrobot.asked) <= 1 + 2  # a request is repeated once
    assert onrobot.written == []
    onrobot.answer = lambda asked, usual: usual
    gripper.command(5.0)
    assert onrobot.written == [(0, [50, 0, 16])]
    assert onrobot.connections == connections


def test_what_pymodbus_logs_is_not_printed(onrobot: FakeOnRobot) -> None:
    """In another process: here pytest takes the log."""
    onrobot.answer = lambda asked, usual: None
    code = (
        "from chromagrip.outside.modbus_grippers import OnRobot\n"
        f"try: OnRobot('rg2', '{onrobot.host}')\nexcept ValueError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == ""
    assert done.stdout == f"rg2 at {onrobot.host} gave no valid answer within 1 s\n"


# The loop


class Stronger:
    """A controller that asks for 25 N and 1 N more at each frame."""

    def reset(self) -> None:
        self._force = 24.0

    def command(self, observation: GripObservation) -> GripCommand:
        self._force += 1.0
        return GripCommand(force=self._force)


SCENE = {"duration_s": 0.06, "camera.rest_frames": 2, "camera.latency_frames": 0}


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with nine pictures of the sensor at rest: the controller looks at none."""
    folder = tmp_path_factory.mktemp("taken")
    scene = load_scene("camera-100hz", SCENE | {"path": "truth"})
    with chromagrip.open(scene) as rig:
        rig.reset()
        for k, frame in enumerate(open_camera(scene).expose_rest(rig.truth.state, 9)):
            assert cv2.imwrite(str(folder / f"{k}.png"), frame.image[..., ::-1])
    return folder


@pytest.fixture
def loop(taken: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Device], dict[str, object]]:
    """Run a loop of seven frames, 25 N to 31 N, with a fake device."""
    monkeypatch.setitem(sys.modules, "stronger", sys.modules[__name__])
    scene = load_scene("camera-100hz", SCENE | {"controller": "stronger:Stronger"})

    def grasped(device: Device, **arguments: object) -> dict[str, object]:
        given = {"model": "2f-85", "host": device.host} | arguments
        result = run_outside(
            scene, str(taken), gripper="robotiq", gripper_arguments=given, fps=100.0
        )
        return result.summary

    return grasped


def steps(device: Device) -> list[int]:
    """Force register of each write that closes."""
    return [values[2] & 0xFF for _, values in device.written if values[0] == 0x0900]


#: Of 25 N to 31 N: (F − 20 N)·255/215 N is 5.93, 7.12, 8.30, 9.49, 10.67, 11.86, 13.05.
STEPS = [6, 7, 8, 9, 11, 12, 13]


def test_the_loop_commands_every_frame(
    loop: Callable[[Device], dict[str, object]], robotiq: FakeRobotiq
) -> None:
    summary = loop(robotiq)
    assert (summary["complete"], summary["gripper"]) == (True, "robotiq")
    assert robotiq.written[0] == (0, [0x0100, 0, 0])  # 0 N first
    assert steps(robotiq) == STEPS


def test_after_a_lost_connection_the_last_safe_grip_is_sent_again(
    loop: Callable[[Device], dict[str, object]], robotiq: FakeRobotiq
) -> None:
    lost = []

    def answer(asked: bytes, usual: bytes) -> bytes:
        if steps(robotiq) == STEPS[:4] and asked[1] == 16 and not lost:
            lost.append(robotiq.written.pop())  # it is lost on its way
            return b""
        return usual

    robotiq.answer = answer
    words = (
        rf"^gripper robotiq failed at t = 0\.03 s, frame 3: 2f-85 at {robotiq.host} lost the "
        r"connection; the grip stays at 27 N$"
    )
    with pytest.raises(UserError, match=words):
        loop(robotiq)
    assert lost
    assert steps(robotiq) == [6, 7, 8, 8]


def test_a_fault_ends_the_loop(
    loop: Callable[[Device], dict[str, object]], robotiq: FakeRobotiq
) -> None:
    def answer(asked: bytes, usual: bytes) -> bytes:
        if len(steps(robotiq)) == 3:
            robotiq.registers[1] = 0x0E00
        return usual

    robotiq.answer = answer
    with pytest.raises(UserError, match=r"reports fault 14: .*; the grip stays at 27 N$"):
        loop(robotiq)
    assert steps(robotiq) == [6, 7, 8]


@pytest.mark.usefixtures("soon")
def test_silence_ends_the_loop(
    loop: Callable[[Device], dict[str, object]], robotiq: FakeRobotiq
) -> None:
    robotiq.answer = lambda asked, usual: usual if len(steps(robotiq)) < 2 else None
    with pytest.raises(
        UserError, match=r"gave no valid answer within 0\.4 s; the grip stays at 25"
    ):
        loop(robotiq)


def test_the_limit_of_an_answer_holds_as_for_every_gripper(robotiq: FakeRobotiq) -> None:
    held = HeldGripper(Robotiq("2f-85", host=robotiq.host), "robotiq", 0.2)
    robotiq.answer = lambda asked, usual: None
    with pytest.raises(UserError, match=r"^gripper robotiq did not answer within 0\.2 s at once$"):
        held.command(30.0, "at once")


def test_from_the_command_line(typed: Typed, taken: Path, robotiq: FakeRobotiq) -> None:
    line = ["grasp", "camera-100hz", "--source", taken, "--set", "duration_s=0.02", "--json"]
    line += ["--set", "camera.rest_frames=2", "--gripper", "robotiq"]
    ours = ["--gripper-arg", f"host={robotiq.host}", "--gripper-arg", "model=hand-e"]
    done = typed(*line, *ours, "--gripper-arg", "floor=true")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["gripper"] == "robotiq"
    assert steps(robotiq) == [0]  # the forces of this scene are small
    done = typed(*line, *ours)
    assert (done.returncode, done.stdout) == (2, "")
    (sentence,) = done.stderr.strip().splitlines()
    assert re.search(r"hand-e at \S+ cannot hold [\d.]+ N: .*; the grip stays at 0 N$", sentence)
    done = typed(*line, "--gripper-arg", "model=2f-85", "--gripper-arg", "host=127.0.0.1:1")
    (sentence,) = done.stderr.strip().splitlines()
    assert sentence == (
        "chromagrip: gripper 'robotiq' cannot be made with model, host: 2f-85 at 127.0.0.1:1 "
        "cannot be reached: Connection refused"
    )
    assert typed("list", "grippers").stdout.split()[0] == "simulated"
