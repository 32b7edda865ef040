"""Logs for other tools hold the run: they are read back by the tools' own readers."""

import json
from collections import defaultdict
from collections.abc import Callable, Iterable
from fractions import Fraction
from functools import reduce
from pathlib import Path
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
from chromagrip.sources import open_source

from .test_pinch import COARSE
from .test_raw_frames import Ends

QUICK = {"duration_s": 0.07, "camera.rest_frames": 2, "camera.dropped": 0.3, "tracker": "quick"}
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
    """An MCAP file as readers of others give it; definitions of its messages are its own."""

    def __init__(self, path: Path) -> None:
        self.messages = defaultdict[str, list[tuple[int, Any]]](list)
        with AnyReader([path]) as bag:
            self.kinds = {one.topic: one.msgtype for one in bag.connections}
            for one, time, data in bag.messages():
                read = bag.deserialize(data, one.msgtype)
                if header := getattr(read, "header", None):
                    assert header.stamp.sec * 10**9 + header.stamp.nanosec == time
                self.messages[one.topic].append((time, read))
        with path.open("rb") as file:
            reader = make_reader(file)
            assert reader.get_header().profile == "ros2"
            summary = reader.get_summary()
            assert summary is not None
            self.about = {each.topic: each.metadata for each in summary.channels.values()}
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
    names = ("load_n/lateral", "grip_n/applied", "mu/estimated", "slip_mm/lateral_displacement")
    for name, unit in zip((*names, "wrench/true"), ("N", "N", "1", "mm", "N, N·m"), strict=True):
        assert read.about[f"/{name}"]["unit"] == unit
    assert read.scene == (chain / "scene.toml").read_text("utf-8")
    summary = json.loads((chain / "summary.json").read_text())
    assert read.facts["controller"] == summary["controller"]


@pytest.mark.loops
def test_two_fingers_have_two_sets_and_raw_pictures(tmp_path: Path) -> None:
    run(load_scene("pinch-lift", PINCH), tmp_path, frames="png", log=("mcap",))
    read, of = Read(tmp_path / "run.mcap"), columns(tmp_path)
    margin = ("/margin/estimated", "margin_estimated", ("margin_low", "margin_high"))
    for finger in ("first", "second"):
        same_numbers(read, of, [margin, ("/normal_n/true", "normal_true_n", ())], f"{finger}_")
        for kind in ("true", "estimated"):
            names = {axis: f"+{finger}_force_{axis}_{kind}_n" for axis in "xyz"}
            names["turn"] = f"+{finger}_torque_{kind}_nmm"
            same_wrench(read, f"/{finger}/wrench/{kind}", of, names)
        assert np.ptp(of[f"{finger}_torque_true_nmm"]) > 0.0
        assert f"/{finger}/limit_margin/estimated" in read.kinds
        files = sorted((tmp_path / "frames" / finger).glob("frame-*.png"))
        data = [value.data.tobytes() for _, value in read.messages[f"/{finger}/camera"]]
        assert data == [file.read_bytes() for file in files]
        assert set(read.of(f"/{finger}/camera", "format")) == {"png"}
    assert "/margin/target" not in read.kinds
    same_numbers(read, of, [("/grip_n/commanded", "grip_n", ()), ("/load_n/table", "table_n", ())])


@pytest.mark.loops
def test_pictures_of_the_video_have_the_instants_of_their_frames(tmp_path: Path) -> None:
    """Of a camera whose rate is none of the video's, with raw pictures to compare with."""
    run(load_scene("margin-60hz", {**QUICK, "duration_s": 0.2}), tmp_path, frames="ffv1")
    frames = list(open_source(str(tmp_path / "frames/frames.mkv")).frames())
    (tmp_path / "frames/frames.csv").unlink()
    (path,) = write_logs_again([tmp_path], ["mcap"])
    read, of = Read(path), columns(tmp_path)
    came = of["time_s"][np.isfinite(of["markers_visible"])]
    assert 3 < len(came) < len(of["time_s"])
    for topic in ("/camera", "/contact"):
        np.testing.assert_array_equal(read.times(topic), nanoseconds(came))
        assert set(read.of(topic, "format")) == {"jpeg"}
    for (_, value), frame in zip(read.messages["/camera"], frames, strict=True):
        picture = cv2.imdecode(value.data, 1)[..., ::-1]
        assert np.abs(picture.astype(float) - frame.image).mean() < 6.0
    shown = next(iter(open_source(str(tmp_path / "tactile.mp4")).frames())).image
    drawn = cv2.imdecode(read.messages["/contact"][0][1].data, 1)[..., ::-1].astype(float)
    assert np.abs(drawn - shown[HEAD:, picture.shape[1] :]).mean() < 6.0


def statuses(read: Read, name: str) -> list[Any]:
    messages = [value.status for _, value in read.messages["/diagnostics"]]
    return [next(one for one in status if one.name == name) for status in messages]


def test_diagnostics_say_what_is_wrong(chain: Path) -> None:
    read, of = Read(chain / "run.mcap"), columns(chain)
    dropped = np.isnan(of["markers_visible"])
    estimate = statuses(read, "estimate")
    assert [one.level for one in estimate] == dropped.astype(int).tolist()
    assert {one.message for one in estimate} == {"forces are estimated", "the frame was dropped"}
    assert {(v.key, v.value) for one in estimate for v in one.values} == {("latency_ms", "10")}
    assert {one.level for one in statuses(read, "slip")} == {0}


@pytest.mark.loops
def test_a_slide_is_an_error_and_a_controller_without_a_target_has_none(tmp_path: Path) -> None:
    weak = {"controller": "conservative", "conservative.force_n": 0.3, "load.forces_n": [0.1, 2.0]}
    slides = {"path": "truth", "duration_s": 0.08, "load.times_s": [0.02, 0.04], **weak}
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


def test_a_log_that_cannot_be_written_leaves_the_run(
    chain: Path, small_files: Callable[[int], None], tmp_path: Path
) -> None:
    names = (*FILES, "run.mcap")
    before = {name: (chain / name).read_bytes() for name in names}
    for name in names:
        (tmp_path / name).write_bytes(before[name])
    small_files(20_000)
    with pytest.raises(UserError, match="cannot be written"):
        write_logs_again([tmp_path], ["mcap"])
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_rerun_holds_the_run(chain: Path) -> None:
    chunks = pytest.importorskip("rerun.chunk", reason="needs the extra viz, of 2026 or later")
    (path,) = write_logs_again([chain], ["rerun"])
    of, cells = columns(chain), defaultdict[str, list[tuple[float, Any]]](list)
    for chunk in chunks.RrdReader(path).stream():
        batch = chunk.to_record_batch()
        names = [n for n in batch.schema.names if n.split(":")[-1] in ("scalars", "blob", "text")]
        if chunk.is_static or not names:
            continue
        times = 1e-9 * batch["time"].cast("int64").to_numpy()
        cells[chunk.entity_path] += zip(times, batch[names[0]].to_pylist(), strict=True)

    def same(entity: str, column: np.ndarray, part: int = 0) -> None:
        times, values = zip(*cells[entity], strict=True)
        there = np.isfinite(column)
        np.testing.assert_allclose(times, of["time_s"][there], atol=1e-9)
        np.testing.assert_array_equal(np.array(values)[:, part], column[there])

    for topic, name, interval in NUMBERS:
        for end, column in zip(("", "/low", "/high"), (name, *interval), strict=False):
            same(topic + end, of[column])
    same("/wrench/estimated/force_n", -of["normal_estimated_n"], 2)
    messages = Read(chain / "run.mcap").messages["/camera"]
    assert [bytes(cell[0]) for _, cell in cells["/camera"]] == [bytes(m.data) for _, m in messages]
    assert [t for t, _ in cells["/camera"]] == pytest.approx([1e-9 * t for t, _ in messages])
    words = [cell[0] for _, cell in cells["/diagnostics/estimate"]]
    assert words[:2] == ["estimate: forces are estimated", "estimate: the frame was dropped"]
    path.unlink()
