"""Logs for other tools hold the run: they are read back by the tools' own readers."""

import json
from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import reduce
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from chromagrip import UserError, load_scene, run
from chromagrip.loop.results.reports import write_logs_again
from chromagrip.loop.results.tactile_video import HEAD
from chromagrip.loop.run_files import FILES
from chromagrip.output.png import encode_png
from chromagrip.outside.grasp import run_outside
from chromagrip.sources import open_source

from .test_pinch import COARSE
from .test_raw_frames import Ends

QUICK = {"duration_s": 0.2, "camera.rest_frames": 2, "camera.dropped": 0.3}
DOME = {"path": "truth", "dome.pitch_mm": 0.8, "duration_s": 0.1}
PINCH = {**COARSE, "duration_s": 0.2, "controller": "conservative"}

#: Topic, column of the trace, and those of the ends of its interval.
NUMBERS = (
    ("/margin/true", "margin_true", ()),
    ("/margin/estimated", "margin_estimated", ("margin_low", "margin_high")),
    ("/mu/estimated", "mu_estimated", ("mu_low", "mu_high")),
    ("/grip_n/commanded", "grip_n", ()),
    ("/grip_n/applied", "applied_n", ()),
    ("/load_n/lateral", "load_n", ()),
    ("/friction_n/true", "friction_true_n", ()),
    ("/normal_n/estimated", "normal_estimated_n", ()),
    ("/slip_mm/lateral_displacement", "lateral_displacement_mm", ()),
)


class Read:
    """An MCAP file as two readers give it; the definitions of its messages are those that it holds.

    Both give the same bytes at the same times. What has a header has the time of its message.
    """

    def __init__(self, path: Path) -> None:
        self.messages: dict[str, list[tuple[int, Any]]] = {}
        found: dict[str, list[tuple[int, bytes]]] = {}
        with AnyReader([path]) as bag:
            self.types = bag.typestore
            self.kinds = {one.topic: one.msgtype for one in bag.connections}
            for one, time, data in bag.messages():
                read = bag.deserialize(data, one.msgtype)
                if header := getattr(read, "header", None):
                    assert header.stamp.sec * 10**9 + header.stamp.nanosec == time
                self.messages.setdefault(one.topic, []).append((time, read))
                found.setdefault(one.topic, []).append((time, bytes(data)))
        with path.open("rb") as file:
            reader = make_reader(file)
            assert reader.get_header().profile == "ros2"
            summary = reader.get_summary()
            assert summary is not None
            assert {each.encoding for each in summary.schemas.values()} == {"ros2msg"}
            assert {each.message_encoding for each in summary.channels.values()} == {"cdr"}
            self.about = {each.topic: each.metadata for each in summary.channels.values()}
            self.raw: dict[str, list[tuple[int, bytes]]] = {}
            for _, channel, message in reader.iter_messages():
                self.raw.setdefault(channel.topic, []).append((message.log_time, message.data))
            assert self.raw == found
            self.facts = {k: v for one in reader.iter_metadata() for k, v in one.metadata.items()}
            self.scene = "".join(one.data.decode() for one in reader.iter_attachments())

    def of(self, topic: str, *path: str) -> np.ndarray:
        """A field of the messages of a topic."""
        return np.array([reduce(getattr, path, value) for _, value in self.messages[topic]])

    def times(self, topic: str) -> np.ndarray:
        """Times of the messages of a topic [ns]."""
        return np.array([time for time, _ in self.messages[topic]])


def nanoseconds(times: np.ndarray) -> np.ndarray:
    """Times [s] in whole nanoseconds."""
    return np.array([round(Fraction(time) * 10**9) for time in times.tolist()])


def columns(folder: Path) -> dict[str, np.ndarray]:
    table = pq.read_table(folder / "trace.parquet")
    return {name: table[name].to_numpy().astype(float) for name in table.column_names}


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run of a chain through its camera, of which frames are dropped."""
    folder = tmp_path_factory.mktemp("runs") / "chain"
    run(load_scene("camera-100hz", QUICK), folder, log=("mcap",))
    return folder


@pytest.fixture(scope="module")
def dome(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "dome"
    run(load_scene("dome-1", DOME), folder, log=("mcap",))
    return folder


@pytest.fixture(scope="module")
def pinch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run of two fingers, whose raw pictures are kept."""
    folder = tmp_path_factory.mktemp("runs") / "pinch"
    run(load_scene("pinch-lift", PINCH), folder, frames="png", log=("mcap",))
    return folder


def same_numbers(
    read: Read, of: dict[str, np.ndarray], numbers: Iterable[Any], before: str = ""
) -> None:
    """Every finite value of each column is a message, at the time of its frame."""
    for topic, name, interval in numbers:
        place = f"/{before.rstrip('_')}{topic}" if before else topic
        for end, column in zip(("", "/low", "/high"), (name, *interval), strict=False):
            there = np.isfinite(of[before + column])
            assert there.any(), name
            np.testing.assert_array_equal(read.times(place + end), nanoseconds(of["time_s"][there]))
            np.testing.assert_array_equal(read.of(place + end, "data"), of[before + column][there])


@pytest.mark.loops
def test_numbers_are_those_of_the_trace(chain: Path) -> None:
    read, of = Read(chain / "run.mcap"), columns(chain)
    assert np.isnan(of["margin_estimated"][1:]).any()  # frames were dropped
    same_numbers(read, of, NUMBERS)
    known = np.isfinite(of["normal_estimated_n"])
    spread = 1.6448536 * of["normal_deviation_n"][known]
    low, high = (read.of(f"/normal_n/estimated/{end}", "data") for end in ("low", "high"))
    np.testing.assert_allclose(high - low, 2 * spread, rtol=1e-3)
    assert set(read.of("/margin/target", "data")) == {0.3}


def test_every_number_has_a_unit_and_the_file_its_scene(chain: Path, pinch: Path) -> None:
    for folder in (chain, pinch):
        read = Read(folder / "run.mcap")
        for topic, kind in read.kinds.items():
            if kind == "std_msgs/msg/Float64":
                about = read.about[topic]
                assert about["meaning"]
                group = topic.removesuffix("/low").removesuffix("/high").split("/")[-2]
                unit = {"n": "N", "mm": "mm", "g": "g", "deg": "°", "kpa": "kPa", "m": "N/m"}
                assert about["unit"] == unit.get(group.rpartition("_")[2], "1"), topic
        assert read.scene == (folder / "scene.toml").read_text("utf-8")
        assert (
            read.facts["controller"]
            == json.loads((folder / "summary.json").read_text())["controller"]
        )
    assert Read(chain / "run.mcap").about["/wrench/true"]["unit"] == "N, N·m"


def test_the_wrench_of_a_chain(chain: Path) -> None:
    read, of = Read(chain / "run.mcap"), columns(chain)
    for kind in ("true", "estimated"):
        topic = f"/wrench/{kind}"
        assert read.kinds[topic] == "geometry_msgs/msg/WrenchStamped"
        known = np.isfinite(of[f"normal_{kind}_n"])
        force = {axis: read.of(topic, "wrench", "force", axis) for axis in "xyz"}
        np.testing.assert_array_equal(force["z"], -of[f"normal_{kind}_n"][known])
        np.testing.assert_array_equal(force["x"], of[f"friction_{kind}_n"][known])
        assert not force["y"].any()
        np.testing.assert_array_equal(read.times(topic), nanoseconds(of["time_s"][known]))
        assert read.messages[topic][0][1].header.frame_id == "fingertip"
    assert not np.isfinite(of["normal_estimated_n"]).all()


def test_the_wrench_of_a_dome_has_a_torque(dome: Path) -> None:
    read, of = Read(dome / "run.mcap"), columns(dome)
    for kind in ("true", "estimated"):
        for axis in "xyz":
            found = read.of(f"/wrench/{kind}", "wrench", "force", axis)
            np.testing.assert_array_equal(found, of[f"force_{axis}_{kind}_n"])
        torque = read.of(f"/wrench/{kind}", "wrench", "torque", "z")
        np.testing.assert_allclose(torque, 1e-3 * of[f"torque_{kind}_nmm"], rtol=1e-12)
        assert np.ptp(torque) > 0.0
    assert "/limit_margin/estimated" in read.kinds


def test_two_fingers_have_two_sets(pinch: Path) -> None:
    read, of = Read(pinch / "run.mcap"), columns(pinch)
    numbers = [
        ("/margin/true", "margin_true", ()),
        ("/margin/estimated", "margin_estimated", ("margin_low", "margin_high")),
        ("/mu/estimated", "mu_estimated", ("mu_low", "mu_high")),
        ("/normal_n/true", "normal_true_n", ()),
        ("/friction_n/estimated", "friction_estimated_n", ()),
    ]
    for before in ("first_", "second_"):
        same_numbers(read, of, numbers, before)
        for kind in ("true", "estimated"):
            topic = f"/{before[:-1]}/wrench/{kind}"
            for axis in "xyz":
                found = read.of(topic, "wrench", "force", axis)
                np.testing.assert_array_equal(found, of[f"{before}force_{axis}_{kind}_n"])
            np.testing.assert_allclose(
                read.of(topic, "wrench", "torque", "z"), 1e-3 * of[f"{before}torque_{kind}_nmm"]
            )
        sizes = np.hypot(of[f"{before}force_x_true_n"], of[f"{before}force_y_true_n"])
        np.testing.assert_allclose(sizes, of[f"{before}friction_true_n"], atol=2e-2)
        np.testing.assert_allclose(
            -of[f"{before}force_z_true_n"], of[f"{before}normal_true_n"], rtol=2e-2, atol=1e-9
        )
        assert "/margin/target" not in read.kinds
    same_numbers(read, of, [("/grip_n/commanded", "grip_n", ()), ("/load_n/table", "table_n", ())])


def test_raw_pictures_lose_nothing(pinch: Path) -> None:
    read = Read(pinch / "run.mcap")
    for finger in ("first", "second"):
        topic, folder = f"/{finger}/camera", pinch / "frames" / finger
        assert read.kinds[topic] == "sensor_msgs/msg/CompressedImage"
        files = sorted(folder.glob("frame-*.png"))
        assert len(files) > 3
        assert [value.data.tobytes() for _, value in read.messages[topic]] == [
            file.read_bytes() for file in files
        ]
        assert set(read.of(topic, "format")) == {"png"}
    assert len(read.messages["/video"]) == len(
        list(open_source(str(pinch / "tactile.mp4")).frames())
    )
    first = cv2.imdecode(read.messages["/video"][0][1].data, 1)
    assert first.shape == (720, 1280, 3)


@pytest.mark.loops
def test_pictures_of_the_video_have_the_instants_of_their_frames(tmp_path: Path) -> None:
    """Of a camera whose rate is none of the video's, with raw pictures to compare with."""
    changes = {**QUICK, "camera.rate_hz": 60.0, "camera.dropped": 0.3}
    run(load_scene("margin-60hz", changes), tmp_path, frames="ffv1")
    (path,) = write_logs_again([tmp_path], ["mcap"])
    lossless = Read(path)
    frames = list(open_source(str(tmp_path / "frames/frames.mkv")).frames())
    data = [value.data.tobytes() for _, value in lossless.messages["/camera"]]
    assert data == [encode_png(frame.image) for frame in frames]
    (tmp_path / "frames/frames.csv").unlink()
    write_logs_again([tmp_path], ["mcap"])
    read, of = Read(path), columns(tmp_path)
    came = of["time_s"][np.isfinite(of["markers_visible"])]
    assert 3 < len(came) < len(of["time_s"])
    for topic in ("/camera", "/contact"):
        np.testing.assert_array_equal(read.times(topic), nanoseconds(came))
        assert set(read.of(topic, "format")) == {"jpeg"}
    np.testing.assert_array_equal(read.times("/camera"), lossless.times("/camera"))
    for (_, value), frame in zip(read.messages["/camera"], frames, strict=True):
        picture = cv2.imdecode(value.data, 1)[..., ::-1]
        assert picture.shape == frame.image.shape
        assert np.abs(picture.astype(float) - frame.image).mean() < 6.0
    shown = next(iter(open_source(str(tmp_path / "tactile.mp4")).frames())).image
    drawn = cv2.imdecode(read.messages["/contact"][0][1].data, 1)
    part = shown[HEAD:, picture.shape[1] :]
    assert np.abs(drawn[..., ::-1].astype(float) - part).mean() < 6.0


def statuses(read: Read, name: str) -> list[Any]:
    found = [
        [s for s in value.status if s.name == name] for _, value in read.messages["/diagnostics"]
    ]
    return [one for (one,) in found]


def test_diagnostics_say_what_is_wrong(chain: Path, tmp_path: Path) -> None:
    read, of = Read(chain / "run.mcap"), columns(chain)
    assert read.kinds["/diagnostics"] == "diagnostic_msgs/msg/DiagnosticArray"
    dropped = np.isnan(of["markers_visible"])
    estimate = statuses(read, "estimate")
    assert [one.level for one in estimate] == dropped.astype(int).tolist()
    assert {one.message for one in estimate} == {"forces are estimated", "the frame was dropped"}
    assert {(v.key, v.value) for one in estimate for v in one.values} == {("latency_ms", "10")}
    assert {one.level for one in statuses(read, "slip")} == {0}
    weak = {"controller": "conservative", "conservative.force_n": 0.3, "load.forces_n": [0.1, 2.0]}
    slides = {"path": "truth", "duration_s": 0.4, "load.times_s": [0.02, 0.2], **weak}
    run(load_scene("camera-100hz", slides), tmp_path, log=("mcap",))
    read, of = Read(tmp_path / "run.mcap"), columns(tmp_path)
    slid = of["lateral_displacement_mm"] > 0.2
    assert 0 < slid.sum() < len(slid)
    assert [one.level for one in statuses(read, "slip")] == (2 * slid).tolist()
    assert "/margin/target" not in read.kinds  # such a controller has none


def test_a_finished_run_is_logged_again(
    chain: Path, tmp_path: Path, typed: Callable[..., CompletedProcess[str]]
) -> None:
    data = (chain / "run.mcap").read_bytes()
    (chain / "run.mcap").unlink()
    done = typed("report", chain, "--out", tmp_path / "page.html", "--log", "mcap")
    assert done.stdout.split() == [str(tmp_path / "page.html"), str(chain / "run.mcap")]
    assert (chain / "run.mcap").read_bytes() == data


def test_from_the_command_line(typed: Callable[..., CompletedProcess[str]], tmp_path: Path) -> None:
    line = ["grasp", "--path", "truth", "--set", "duration_s=0.02", "--log", "mcap"]
    assert typed(*line, "--out", "run").returncode == 0
    assert {path.name for path in (tmp_path / "run").iterdir()} == {*FILES, "run.mcap"}
    done = typed(*line, "--json")
    assert done.returncode == 2
    assert "--log mcap needs a folder: give --out as well as --json" in done.stderr
    assert typed(*line, "bag", "--out", "run").returncode == 2
    done = typed(*line[:-1], "--out", "run")
    assert done.returncode == 2
    assert "--log: expected one or more of mcap, rerun" in done.stderr
    assert typed(*line[:-2], "--out", "run", "--overwrite").returncode == 0
    assert {path.name for path in (tmp_path / "run").iterdir()} == set(FILES)
    with pytest.raises(UserError, match="a log as mcap needs a folder"):
        run("camera-100hz", log=("mcap",))


def test_an_interrupted_run_is_logged_until_then(tmp_path: Path) -> None:
    scene = load_scene("camera-100hz", {"camera.rest_frames": 2, "camera.latency_frames": 0})
    with pytest.raises(KeyboardInterrupt):
        run(scene, tmp_path, controller=Ends(), log=("mcap",))
    read = Read(tmp_path / "run.mcap")
    assert len(read.messages["/grip_n/commanded"]) == 2
    assert read.facts["complete"] == "False"


@pytest.mark.parametrize("kind", ["mcap", "rerun"])
def test_a_log_that_cannot_be_written_leaves_the_run(
    kind: Any, chain: Path, small_files: Callable[[int], None], tmp_path: Path
) -> None:
    if kind == "rerun":
        pytest.importorskip("rerun", reason="needs the extra viz")
    for name in (*FILES, "run.mcap"):
        (tmp_path / name).write_bytes((chain / name).read_bytes())
    before = (tmp_path / "run.mcap").read_bytes()
    small_files(20_000)
    with pytest.raises(UserError, match="cannot be written"):
        write_logs_again([tmp_path], [kind])
    assert {path.name for path in tmp_path.iterdir()} == {*FILES, "run.mcap"}
    assert (tmp_path / "run.mcap").read_bytes() == before


def test_a_log_that_is_interrupted_has_no_name(
    chain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in FILES:
        (tmp_path / name).write_bytes((chain / name).read_bytes())

    def interrupted(*_: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr("chromagrip.loop.results.log_pictures._jpeg", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_logs_again([tmp_path], ["mcap"])
    assert {path.name for path in tmp_path.iterdir()} == set(FILES)


def test_frames_from_outside_are_logged_without_a_truth(tmp_path: Path) -> None:
    changes = {"duration_s": 0.05, "camera.rest_frames": 2, "camera.latency_frames": 0}
    scene = load_scene("camera-100hz", changes)
    run(scene, tmp_path / "inside", frames="png")
    folder = tmp_path / "pictures"
    folder.mkdir()
    frames = tmp_path / "inside/frames"
    files = [frames / "rest.png", frames / "rest.png", *sorted(frames.glob("frame-*.png"))]
    for number, file in enumerate(files):
        (folder / f"{number}.png").write_bytes(file.read_bytes())
    run_outside(scene, str(folder), tmp_path / "run", fps=100.0, log=("mcap",))
    read, of = Read(tmp_path / "run/run.mcap"), columns(tmp_path / "run")
    assert not [topic for topic in read.kinds if topic.endswith("/true")]
    assert "sensor_msgs/msg/CompressedImage" not in read.kinds.values()
    same_numbers(read, of, [("/margin/estimated", "margin_estimated", ("margin_low",))])
    known = np.isfinite(of["normal_estimated_n"])
    z = read.of("/wrench/estimated", "wrench", "force", "z")
    np.testing.assert_array_equal(z, -of["normal_estimated_n"][known])


# Rerun


class ReadRerun:
    """A file of Rerun as its own reader gives it: times [s] and cells of each entity."""

    def __init__(self, path: Path) -> None:
        from rerun.chunk import RrdReader

        reader = RrdReader(path)
        self.layouts = reader.blueprints()
        self.cells: dict[str, list[tuple[float, Any]]] = {}
        self.static: dict[str, dict[str, Any]] = {}
        for chunk in reader.stream():
            batch = chunk.to_record_batch()
            if chunk.is_static:
                told = batch.to_pylist()[0]
                self.static.setdefault(chunk.entity_path, {}).update(told)
                continue
            names = [
                n for n in batch.schema.names if n.split(":")[-1] in ("scalars", "blob", "text")
            ]
            times = batch["time"].cast("int64").to_pylist()
            for time, cell in zip(times, batch[names[0]].to_pylist(), strict=True):
                self.cells.setdefault(chunk.entity_path, []).append((1e-9 * time, cell))

    def of(self, entity: str) -> tuple[np.ndarray, np.ndarray]:
        times, cells = zip(*self.cells[entity], strict=True)
        return np.array(times), np.array(cells)


def test_rerun_holds_the_run(chain: Path) -> None:
    pytest.importorskip("rerun.chunk", reason="needs the extra viz, of 2026 or later")
    (path,) = write_logs_again([chain], ["rerun"])
    read, of = ReadRerun(path), columns(chain)
    assert len(read.layouts) == 1
    for topic, name, interval in NUMBERS:
        there = np.isfinite(of[name])
        for entity, column in ((topic, name), *zip(("low", "high"), interval, strict=False)):
            entity = entity if entity == topic else f"{topic}/{entity}"
            times, values = read.of(entity)
            np.testing.assert_allclose(times, of["time_s"][there], atol=1e-9)
            np.testing.assert_array_equal(values[:, 0], of[column][there])
    assert read.static["/grip_n/commanded"]["SeriesLines:names"] == ["commanded [N]"]
    times, values = read.of("/wrench/estimated/force_n")
    known = np.isfinite(of["normal_estimated_n"])
    np.testing.assert_array_equal(values[:, 2], -of["normal_estimated_n"][known])
    np.testing.assert_allclose(times, of["time_s"][known], atol=1e-9)
    messages = Read(chain / "run.mcap").messages["/camera"]
    assert [bytes(cell[0]) for _, cell in read.cells["/camera"]] == [
        bytes(m.data) for _, m in messages
    ]
    assert [t for t, _ in read.cells["/camera"]] == pytest.approx([1e-9 * t for t, _ in messages])
    words = [cell[0] for _, cell in read.cells["/diagnostics/estimate"]]
    assert words[:2] == ["estimate: forces are estimated", "estimate: the frame was dropped"]
    assert "duration_s = 0.2" in str(read.static["/run"])
    path.unlink()


def test_rerun_opens_the_mcap_too(chain: Path) -> None:
    """It knows the pictures by their schema."""
    chunks = pytest.importorskip("rerun.chunk", reason="needs the extra viz, of 2026 or later")
    found = 0
    for chunk in chunks.McapReader(chain / "run.mcap").stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path == "/camera" and "EncodedImage:blob" in batch.schema.names:
            found += chunk.num_rows
    assert found == len(Read(chain / "run.mcap").messages["/camera"])


def test_rerun_holds_both_fingers(pinch: Path) -> None:
    pytest.importorskip("rerun.chunk", reason="needs the extra viz, of 2026 or later")
    (path,) = write_logs_again([pinch], ["rerun"])
    read, of = ReadRerun(path), columns(pinch)
    for finger in ("first", "second"):
        times, values = read.of(f"/{finger}/normal_n/true")
        np.testing.assert_allclose(times, of["time_s"], atol=1e-9)
        np.testing.assert_array_equal(values[:, 0], of[f"{finger}_normal_true_n"])
        files = sorted((pinch / "frames" / finger).glob("frame-*.png"))
        cells = read.cells[f"/{finger}/camera"]
        assert [bytes(cell[0]) for _, cell in cells] == [file.read_bytes() for file in files]
    path.unlink()
