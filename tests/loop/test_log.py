"""Logs for other tools hold the run: they are read back by the tools' own readers."""

import json
from collections import defaultdict
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

Typed = Callable[..., CompletedProcess[str]]
QUICK = {"duration_s": 0.07, "camera.rest_frames": 2, "camera.dropped": 0.3}
PINCH = {**COARSE, "duration_s": 0.05, "controller": "conservative"}

#: Topic, column of the trace, and those of the ends of its interval.
NUMBERS = (
    ("/margin/true", "margin_true", ()),
    ("/margin/estimated", "margin_estimated", ("margin_low", "margin_high")),
    ("/mu/estimated", "mu_estimated", ("mu_low", "mu_high")),
    ("/grip_n/applied", "applied_n", ()),
    ("/load_n/lateral", "load_n", ()),
    ("/slip_mm/lateral_displacement", "lateral_displacement_mm", ()),
)


class Read:
    """An MCAP file as two readers give it; the definitions of its messages are those that it holds.

    Both give the same bytes at the same times. What has a header has the time of its message.
    """

    def __init__(self, path: Path) -> None:
        self.messages = defaultdict[str, list[tuple[int, Any]]](list)
        found = []
        with AnyReader([path]) as bag:
            self.kinds = {one.topic: one.msgtype for one in bag.connections}
            for one, time, data in bag.messages():
                read = bag.deserialize(data, one.msgtype)
                if header := getattr(read, "header", None):
                    assert header.stamp.sec * 10**9 + header.stamp.nanosec == time
                self.messages[one.topic].append((time, read))
                found.append((one.topic, time, bytes(data)))
        with path.open("rb") as file:
            reader = make_reader(file)
            assert reader.get_header().profile == "ros2"
            summary = reader.get_summary()
            assert summary is not None
            assert {each.encoding for each in summary.schemas.values()} == {"ros2msg"}
            assert {each.message_encoding for each in summary.channels.values()} == {"cdr"}
            self.about = {each.topic: each.metadata for each in summary.channels.values()}
            raw = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()]
            assert sorted(raw) == sorted(found)
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


def same_wrench(read: Read, topic: str, of: dict[str, np.ndarray], names: dict[str, str]) -> None:
    """Force and torque of the messages are columns, which a minus turns; others are 0."""
    assert read.kinds[topic] == "geometry_msgs/msg/WrenchStamped"
    columns = {axis: float(f"{name[0]}1") * of[name[1:]] for axis, name in names.items()}
    known = np.isfinite(np.array([*columns.values()])).all(axis=0)
    np.testing.assert_array_equal(read.times(topic), nanoseconds(of["time_s"][known]))
    for axis in ("x", "y", "z", "turn"):
        field = ("torque", "z") if axis == "turn" else ("force", axis)
        factor = 1e-3 if axis == "turn" else 1.0
        expected = factor * columns[axis][known] if axis in columns else 0.0
        np.testing.assert_allclose(read.of(topic, "wrench", *field), expected, rtol=1e-12)


def has_units(read: Read, folder: Path) -> None:
    """Every number has a unit, and the file its scene."""
    units = {"n": "N", "mm": "mm", "g": "g", "deg": "°", "kpa": "kPa", "m": "N/m"}
    for topic, kind in read.kinds.items():
        if kind == "std_msgs/msg/Float64":
            assert read.about[topic]["meaning"]
            group = topic.removesuffix("/low").removesuffix("/high").split("/")[-2]
            assert read.about[topic]["unit"] == units.get(group.rpartition("_")[2], "1"), topic
    assert read.scene == (folder / "scene.toml").read_text("utf-8")
    summary = json.loads((folder / "summary.json").read_text())
    assert read.facts["controller"] == summary["controller"]


def test_numbers_are_those_of_the_trace(chain: Path) -> None:
    read, of = Read(chain / "run.mcap"), columns(chain)
    assert np.isnan(of["margin_estimated"][1:]).any()  # frames were dropped
    same_numbers(read, of, NUMBERS)
    known = np.isfinite(of["normal_estimated_n"])
    spread = 1.6448536 * of["normal_deviation_n"][known]
    low, high = (read.of(f"/normal_n/estimated/{end}", "data") for end in ("low", "high"))
    np.testing.assert_allclose(high - low, 2 * spread, rtol=1e-3)
    assert set(read.of("/margin/target", "data")) == {0.3}
    for kind in ("true", "estimated"):
        names = {"x": f"+friction_{kind}_n", "z": f"-normal_{kind}_n"}
        same_wrench(read, f"/wrench/{kind}", of, names)
    assert read.messages["/wrench/true"][0][1].header.frame_id == "fingertip"
    has_units(read, chain)
    assert read.about["/wrench/true"]["unit"] == "N, N·m"


@pytest.mark.loops
def test_two_fingers_have_two_sets(pinch: Path) -> None:
    read, of = Read(pinch / "run.mcap"), columns(pinch)
    has_units(read, pinch)
    numbers = [
        ("/margin/estimated", "margin_estimated", ("margin_low", "margin_high")),
        ("/normal_n/true", "normal_true_n", ()),
    ]
    for before in ("first_", "second_"):
        same_numbers(read, of, numbers, before)
        for kind in ("true", "estimated"):
            names = {axis: f"+{before}force_{axis}_{kind}_n" for axis in "xyz"}
            names["turn"] = f"+{before}torque_{kind}_nmm"
            same_wrench(read, f"/{before[:-1]}/wrench/{kind}", of, names)
        assert np.ptp(of[f"{before}torque_true_nmm"]) > 0.0
        assert f"/{before[:-1]}/limit_margin/estimated" in read.kinds
    assert "/margin/target" not in read.kinds
    same_numbers(read, of, [("/grip_n/commanded", "grip_n", ()), ("/load_n/table", "table_n", ())])


@pytest.mark.loops
def test_raw_pictures_lose_nothing(pinch: Path) -> None:
    read = Read(pinch / "run.mcap")
    for finger in ("first", "second"):
        topic, folder = f"/{finger}/camera", pinch / "frames" / finger
        assert read.kinds[topic] == "sensor_msgs/msg/CompressedImage"
        files = sorted(folder.glob("frame-*.png"))
        assert len(files) == 4
        data = [value.data.tobytes() for _, value in read.messages[topic]]
        assert data == [file.read_bytes() for file in files]
        assert set(read.of(topic, "format")) == {"png"}
    shown = list(open_source(str(pinch / "tactile.mp4")).frames())
    assert len(read.messages["/video"]) == len(shown)
    first = cv2.imdecode(read.messages["/video"][0][1].data, 1)
    assert first.shape == (720, 1280, 3)


@pytest.mark.loops
def test_pictures_of_the_video_have_the_instants_of_their_frames(tmp_path: Path) -> None:
    """Of a camera whose rate is none of the video's, with raw pictures to compare with."""
    run(load_scene("margin-60hz", {**QUICK, "duration_s": 0.2}), tmp_path, frames="ffv1")
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
    drawn = cv2.imdecode(read.messages["/contact"][0][1].data, 1)[..., ::-1].astype(float)
    assert np.abs(drawn - shown[HEAD:, picture.shape[1] :]).mean() < 6.0


def statuses(read: Read, name: str) -> list[Any]:
    messages = [value.status for _, value in read.messages["/diagnostics"]]
    return [next(one for one in status if one.name == name) for status in messages]


def test_diagnostics_say_what_is_wrong(chain: Path, tmp_path: Path) -> None:
    read, of = Read(chain / "run.mcap"), columns(chain)
    assert read.kinds["/diagnostics"] == "diagnostic_msgs/msg/DiagnosticArray"
    dropped = np.isnan(of["markers_visible"])
    estimate = statuses(read, "estimate")
    assert [one.level for one in estimate] == dropped.astype(int).tolist()
    assert {one.message for one in estimate} == {"forces are estimated", "the frame was dropped"}
    assert {(v.key, v.value) for one in estimate for v in one.values} == {("latency_ms", "10")}
    assert {one.level for one in statuses(read, "slip")} == {0}


@pytest.mark.loops
def test_a_slide_is_an_error_and_a_controller_without_a_target_has_none(tmp_path: Path) -> None:
    weak = {"controller": "conservative", "conservative.force_n": 0.3, "load.forces_n": [0.1, 2.0]}
    slides = {"path": "truth", "duration_s": 0.2, "load.times_s": [0.02, 0.1], **weak}
    run(load_scene("camera-100hz", slides), tmp_path, log=("mcap",))
    read, of = Read(tmp_path / "run.mcap"), columns(tmp_path)
    slid = of["lateral_displacement_mm"] > 0.2
    assert 0 < slid.sum() < len(slid)
    assert [one.level for one in statuses(read, "slip")] == (2 * slid).tolist()
    assert "/margin/target" not in read.kinds


def test_a_finished_run_is_logged_again(chain: Path) -> None:
    data = (chain / "run.mcap").read_bytes()
    (chain / "run.mcap").unlink()
    assert write_logs_again([chain], ["mcap"]) == [chain / "run.mcap"]
    assert (chain / "run.mcap").read_bytes() == data


@pytest.mark.loops
def test_from_the_command_line(chain: Path, typed: Typed, tmp_path: Path) -> None:
    done = typed("report", chain, "--out", tmp_path / "page.html", "--log", "mcap")
    assert done.stdout.split() == [str(tmp_path / "page.html"), str(chain / "run.mcap")]
    line = ["grasp", "--path", "truth", "--set", "duration_s=0.02"]
    for words, names in ((["--log", "mcap"], {*FILES, "run.mcap"}), (["--overwrite"], set(FILES))):
        assert typed(*line, *words, "--out", "run").returncode == 0
        assert {path.name for path in (tmp_path / "run").iterdir()} == names
    for words, said in (
        (["mcap", "--json"], "--log mcap needs a folder: give --out as well as --json"),
        (["--out", "run"], "--log: expected one or more of mcap, rerun"),
    ):
        done = typed(*line, "--log", *words)
        assert done.returncode == 2
        assert said in done.stderr
    with pytest.raises(UserError, match="a log as mcap needs a folder"):
        run("camera-100hz", log=("mcap",))


@pytest.mark.loops
def test_an_interrupted_run_is_logged_until_then(tmp_path: Path) -> None:
    scene = load_scene("camera-100hz", {"path": "truth", "camera.latency_frames": 0})
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
    names = (*FILES, "run.mcap")
    before = {name: (chain / name).read_bytes() for name in names}
    for name in names:
        (tmp_path / name).write_bytes(before[name])
    small_files(20_000)
    with pytest.raises(UserError, match="cannot be written"):
        write_logs_again([tmp_path], [kind])
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.loops
def test_frames_from_outside_are_logged_without_a_truth(tmp_path: Path) -> None:
    changes = {"duration_s": 0.05, "camera.rest_frames": 2, "camera.latency_frames": 0}
    scene, folder = load_scene("camera-100hz", changes), tmp_path / "pictures"
    run(scene, tmp_path / "inside", frames="png")
    frames = tmp_path / "inside/frames"
    files = [frames / "rest.png", frames / "rest.png", *sorted(frames.glob("frame-*.png"))]
    folder.mkdir()
    for number, file in enumerate(files):
        (folder / f"{number}.png").write_bytes(file.read_bytes())
    run_outside(scene, str(folder), tmp_path / "run", fps=100.0, log=("mcap",))
    read, of = Read(tmp_path / "run/run.mcap"), columns(tmp_path / "run")
    assert not [topic for topic in read.kinds if topic.endswith("/true")]
    assert "sensor_msgs/msg/CompressedImage" not in read.kinds.values()
    same_numbers(read, of, [("/margin/estimated", "margin_estimated", ("margin_low",))])
    known = {"x": "+friction_estimated_n", "z": "-normal_estimated_n"}
    same_wrench(read, "/wrench/estimated", of, known)


# Rerun


def rerun_cells(path: Path) -> tuple[dict[str, list[tuple[float, Any]]], dict[str, dict[str, Any]]]:
    """Times [s] and cells of each entity of a file of Rerun, and what is static, by its reader."""
    from rerun.chunk import RrdReader

    reader, cells, static = RrdReader(path), defaultdict(list), defaultdict(dict)
    assert len(reader.blueprints()) == 1
    for chunk in reader.stream():
        batch = chunk.to_record_batch()
        if chunk.is_static:
            static[chunk.entity_path].update(batch.to_pylist()[0])
            continue
        (name, *_) = (
            n for n in batch.schema.names if n.split(":")[-1] in ("scalars", "blob", "text")
        )
        times = batch["time"].cast("int64").to_pylist()
        for time, cell in zip(times, batch[name].to_pylist(), strict=True):
            cells[chunk.entity_path].append((1e-9 * time, cell))
    return cells, static


def test_rerun_holds_the_run(chain: Path) -> None:
    pytest.importorskip("rerun.chunk", reason="needs the extra viz, of 2026 or later")
    (path,) = write_logs_again([chain], ["rerun"])
    (cells, static), of = rerun_cells(path), columns(chain)

    def same(entity: str, column: np.ndarray, part: int = 0) -> None:
        times, values = zip(*cells[entity], strict=True)
        there = np.isfinite(column)
        np.testing.assert_allclose(times, of["time_s"][there], atol=1e-9)
        np.testing.assert_array_equal(np.array(values)[:, part], column[there])

    for topic, name, interval in NUMBERS:
        for end, column in zip(("", "/low", "/high"), (name, *interval), strict=False):
            same(topic + end, of[column])
    same("/wrench/estimated/force_n", -of["normal_estimated_n"], 2)
    assert static["/grip_n/commanded"]["SeriesLines:names"] == ["commanded [N]"]
    messages = Read(chain / "run.mcap").messages["/camera"]
    pictures = [bytes(cell[0]) for _, cell in cells["/camera"]]
    assert pictures == [bytes(message.data) for _, message in messages]
    assert [t for t, _ in cells["/camera"]] == pytest.approx([1e-9 * t for t, _ in messages])
    words = [cell[0] for _, cell in cells["/diagnostics/estimate"]]
    assert words[:2] == ["estimate: forces are estimated", "estimate: the frame was dropped"]
    assert "duration_s = 0.07" in str(static["/run"])
    path.unlink()
