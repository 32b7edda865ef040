"""Published readings: what is sent, to whom, and what a controller makes of it."""

import io
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from msgspec.json import encode as json_of
from msgspec.structs import replace

from chromagrip.control import GripObservation
from chromagrip.errors import UserError
from chromagrip.loop.force_row import force_row
from chromagrip.model import ForceField
from chromagrip.publish import SCHEMA, Subscriber, message_of, observation_of, publishing
from chromagrip.render import Frame
from chromagrip.scene import load_scene
from chromagrip.scene.controllers import CONTROLLERS
from chromagrip.sensing.margins import finished, held
from chromagrip.tracking import CAMERA_RULE

FRAME = Frame(image=np.zeros((8, 8, 3), np.uint8), time=0.25)


def seen(time: float, margin: float, twist: float = 0.0) -> GripObservation:
    """Observation of three nodes under 3 N, whose µ is .5 and whose Γ is `margin`."""
    x = np.array([-1.0, 0.0, 1.0])
    pull = 0.5 * (1.0 - margin) * np.ones(3)
    friction = np.stack([pull, twist * x, 0.0 * x], axis=1)
    field = ForceField(
        position=np.stack([3e-3 * x, 0.0 * x, 20e-3 + 0.0 * x], axis=1),
        normal=np.ones(3),
        friction=friction,
        contact=np.ones(3, np.bool_),
        totals_covariance=np.diag([0.01, 0.02]),
        directions=np.tile([0.0, 0.0, -1.0], (3, 1)),
        wrench_covariance=np.diag([1e-2, 2e-2, 3e-2, 1e-6]),
    )
    return finished(
        GripObservation(
            time=time, field=field, friction=0.5, friction_interval=(0.4, 0.6),
            friction_observable=True, margin=margin, margin_interval=(margin - 0.1, margin + 0.1),
            lateral_displacement=float("nan"),
        )
    )  # fmt: skip


def message(observation: GripObservation, **about: float) -> dict[str, object]:
    row = force_row(observation, CAMERA_RULE) | {"frame": 1, "time_s": observation.time}
    made = message_of(row, observation, late_s=about.get("late_s", 0.0), skipped=0)
    return json.loads(json_of(made))


def test_a_message_has_sums_wrench_and_margins_in_their_units() -> None:
    told = message(seen(0.25, 0.3), late_s=0.004)
    assert told["schema"] == SCHEMA
    assert told["time_s"] == 0.25
    assert told["late_s"] == 0.004
    assert told["normal_n"] == pytest.approx(3.0)
    assert told["friction_n"] == pytest.approx(3 * 0.5 * 0.7)
    assert told["force_z_n"] == pytest.approx(-3.0)
    assert told["margin"] == pytest.approx(0.3)
    assert (told["margin_low"], told["margin_high"]) == pytest.approx((0.2, 0.4))
    assert np.array(told["wrench_covariance"]).diagonal() == pytest.approx([1e-2, 2e-2, 3e-2, 1e-6])


@pytest.mark.parametrize("twist", [0.0, 0.2])
def test_every_controller_commands_the_same_from_messages(twist: float) -> None:
    told = [seen(k / 60, 0.5 - 0.02 * k, twist) for k in range(40)]
    pairs = [(held(one, "smaller"), observation_of(message(one))) for one in told]
    for name in CONTROLLERS.entries:
        scene = replace(load_scene("chromatouch-2022"), controller=name)
        one, other = scene.build_controller(), scene.build_controller()
        for direct, sent in pairs:
            assert other.command(sent).force == pytest.approx(one.command(direct).force), name


def test_the_newest_line_of_a_pipe_wins(until: Callable[..., None]) -> None:
    reads, writes = os.pipe()
    with os.fdopen(reads, "rb") as end, os.fdopen(writes, "wb", 0) as pipe:
        readings = Subscriber(end)
        assert readings.next(0.0) is None
        for k in range(3):
            pipe.write(json_of(message(seen(k / 60, 0.3))) + b"\n")
        until(lambda: readings.skipped == 2)
        told = readings.next(1.0)
        assert told is not None
        assert told["time_s"] == pytest.approx(2 / 60)
        assert readings.next(0.01) is None
        assert not readings.ended
        pipe.write(json_of(message(seen(1.0, 0.3)))[:40])  # whose writer was killed
        pipe.close()
        with pytest.raises(UserError, match="the pipe has no reading"):
            readings.next(1.0)
        until(lambda: readings.ended)


def test_lines_of_json_are_appended(tmp_path: Path) -> None:
    path = tmp_path / "readings.jsonl"
    for k in range(2):
        with publishing([f"jsonl:{path}"]) as (send,):
            send(message(seen(float(k), 0.3)), FRAME)
    times = [json.loads(line)["time_s"] for line in path.read_text().splitlines()]
    assert times == [0.0, 1.0]


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("udp:5005", "--publish udp:5005: allowed are jsonl:-, jsonl:FILE and mcap:FILE"),
        ("jsonl:", "allowed are"),
        ("jsonl:/no/such/folder/x", "cannot be written"),
        (f"mcap:{__file__}", "exists already"),
    ],
)
def test_a_target_that_is_none_is_refused(target: str, words: str) -> None:
    with pytest.raises(UserError, match=words), publishing([target]):
        pass


@pytest.mark.parametrize("data", [b"[1]", b"\xff", b'{"schema":"chromagrip reading 0"}'])
def test_a_message_of_another_version_is_refused(data: bytes) -> None:
    with pytest.raises(UserError, match="wanted: 'chromagrip reading 1'"):
        Subscriber(io.BytesIO(data)).next(1.0)


def test_every_message_has_the_same_keys_and_one_without_an_estimate_says_why() -> None:
    row = force_row(seen(0.0, 0.3), CAMERA_RULE)
    known = message_of(row, seen(0.0, 0.3), late_s=0.0, skipped=0, columns=("normal_n", "margin"))
    row = {"frame": 3, "time_s": 0.1, "no_estimate": "too dark"}
    unknown = message_of(row, None, late_s=0.0, skipped=2, columns=known, doubt="assumed")
    assert set(known) <= set(unknown)
    assert (unknown["margin"], unknown["doubt"], unknown["skipped"]) == (None, "assumed", 2)
    observation = observation_of(json.loads(json_of(unknown)))
    assert observation.no_estimate == "too dark"
    assert np.isnan(observation.margin)
