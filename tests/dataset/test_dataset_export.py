"""Datasets in the layouts of others, read as their tools read them."""

import json
import pickle
import shutil
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

from chromagrip import UserError
from chromagrip.dataset import Loaded, load_sequences
from chromagrip.dataset.export.layouts import LAYOUTS, export
from chromagrip.dataset.export.lerobot import CAMERA, FORCES, MARKERS, STATE, write_lerobot
from chromagrip.dataset.split import split


@pytest.fixture(scope="module")
def loaded(tiny: Path) -> list[Loaded]:
    """Its sequences."""
    return list(load_sequences(tiny))


def test_labels_lie_on_the_markers(loaded: list[Loaded]) -> None:
    """A label's pixel is a marker's colour, and the skin's between markers is lighter."""
    for one in loaded:
        image = list(one.images())[-1].astype(float)
        places, seen = one.places[-1], one.visible[-1]
        for layer, channel in ((0, 1), (1, 2)):  # magenta takes green, yellow takes blue
            x, y = np.rint(places[layer, seen[layer]]).astype(int).T
            assert image[y, x, channel].mean() < 0.6 * image[240, 320 - 9].max()


def test_tapvid_is_as_its_reader_takes_it(tiny: Path, loaded: list[Loaded], tmp_path: Path) -> None:
    """Points times the size of the video lie on the markers; the arrays fit together."""
    export(tiny, "tapvid", tmp_path / "out")
    found = pickle.loads((tmp_path / "out" / "tapvid-00000.pkl").read_bytes())
    assert list(found) == [f"sequence-{one.number:06d}" for one in loaded]
    for one, said in zip(loaded, found.values(), strict=True):
        video, points, occluded = said["video"], said["points"], said["occluded"]
        assert (video.dtype, video.shape) == (np.uint8, (7, 480, 640, 3))
        assert points.shape == (*occluded.shape, 2)
        assert occluded.dtype == bool
        assert ((points >= 0.0) & (points <= 1.0))[~occluded].all()
        back = points * [640, 480] - 0.5
        np.testing.assert_allclose(back[0, 3], one.places[3, 0, 0], atol=1e-4)


def test_coco_is_as_its_reader_takes_it(tiny: Path, loaded: list[Loaded], tmp_path: Path) -> None:
    coco = pytest.importorskip("pycocotools.coco")
    export(tiny, "coco", tmp_path / "out")
    read = coco.COCO(str(tmp_path / "out" / "annotations.json"))
    assert len(read.getImgIds()) == 21
    (category,) = read.loadCats(read.getCatIds())
    for number in read.getImgIds()[::5]:
        (image,) = read.loadImgs(number)
        picture = cv2.imread(str(tmp_path / "out" / "images" / image["file_name"]))
        assert picture is not None
        assert picture.shape == (image["height"], image["width"], 3)
        (one,) = read.loadAnns(read.getAnnIds(number))
        points = np.reshape(one["keypoints"], (-1, 3))
        assert len(points) == len(category["keypoints"]) == 800
        assert one["num_keypoints"] == (points[:, 2] > 0).sum()
        x, y, w, h = one["bbox"]
        seen = points[points[:, 2] > 0, :2] + 0.5
        assert (seen >= np.array([x, y]) - 1e-2).all()
        assert (seen <= np.array([x + w, y + h]) + 1e-2).all()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # the reader's
def test_webdataset_is_as_its_reader_takes_it(
    tiny: Path, loaded: list[Loaded], tmp_path: Path
) -> None:
    webdataset = pytest.importorskip("webdataset")
    export(tiny, "webdataset", tmp_path / "out")
    path = tmp_path / "out" / "frames-000000.tar"
    with tarfile.open(path) as tar:
        assert {(m.mtime, m.uid, m.uname) for m in tar.getmembers()} == {(0, 0, "")}
    samples = list(webdataset.WebDataset(str(path), shardshuffle=False).decode("rgb8"))
    assert len(samples) == 21
    first = samples[7]
    assert first["__key__"] == "000001-000"
    np.testing.assert_array_equal(first["png"], next(loaded[1].images()))
    assert first["json"]["sequence"] == 1
    assert first["json"]["margin"] is None  # not in contact yet
    np.testing.assert_array_equal(first["npz"]["x_px"], loaded[1].markers["x_px"][0])


def test_lerobot_has_its_tables_video_and_meta(
    tiny: Path, loaded: list[Loaded], tmp_path: Path
) -> None:
    """Each frame of an episode is found by its time in the video, nearly as it was."""
    export(tiny, "lerobot", tmp_path / "out")
    out = tmp_path / "out"
    info = json.loads((out / "meta" / "info.json").read_text("utf-8"))
    assert (info["codebase_version"], info["total_episodes"], info["total_frames"]) == (
        "v3.0",
        3,
        21,
    )
    data = pq.read_table(out / info["data_path"].format(chunk_index=0, file_index=0))
    features = info["features"]
    assert set(data.column_names) == set(features) - {CAMERA}
    assert data["index"].to_pylist() == list(range(21))
    state = np.array(data["observation.state"].to_pylist())
    assert state.shape == (21, len(STATE))
    np.testing.assert_allclose(state[7:14, 0], loaded[1].frames["grip_n"], rtol=1e-6)
    episodes = pq.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    tasks = pq.read_table(out / "meta/tasks.parquet")
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    path = out / info["video_path"].format(video_key=CAMERA, chunk_index=0, file_index=0)
    with av.open(str(path)) as video:
        stream = video.streams.video[0]
        assert (stream.codec_context.pix_fmt, stream.average_rate) == ("yuv444p", 60)
        shown = {round(f.time * 60): f.to_ndarray(format="rgb24") for f in video.decode(stream)}
    assert len(shown) == 21
    for one, episode in zip(loaded, episodes, strict=True):
        assert episode["tasks"] == [one.values["motion"]]
        start = round(episode[f"videos/{CAMERA}/from_timestamp"] * 60)
        assert start == episode["dataset_from_index"]
        for t, image in enumerate(one.images()):
            error = shown[start + t].astype(float) - image
            assert np.sqrt((error**2).mean()) < 4.0


#: Layout that LeRobot 0.6.1 writes for the same features: keys of `meta/info.json`, its own
#: features, columns of the episodes, and kinds of statistics.
PUBLISHED_INFO = {
    "codebase_version", "fps", "features", "total_episodes", "total_frames", "total_tasks",
    "chunks_size", "data_files_size_in_mb", "video_files_size_in_mb", "data_path", "video_path",
    "robot_type", "splits",
}  # fmt: skip
PUBLISHED_FEATURES = {
    "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    "frame_index": {"dtype": "int64", "shape": [1], "names": None},
    "episode_index": {"dtype": "int64", "shape": [1], "names": None},
    "index": {"dtype": "int64", "shape": [1], "names": None},
    "task_index": {"dtype": "int64", "shape": [1], "names": None},
}
PUBLISHED_EPISODES = {
    "episode_index": "int64", "tasks": "list<element: string>", "length": "int64",
    "data/chunk_index": "int64", "data/file_index": "int64",
    "dataset_from_index": "int64", "dataset_to_index": "int64",
    "meta/episodes/chunk_index": "int64", "meta/episodes/file_index": "int64",
    f"videos/{CAMERA}/chunk_index": "int64", f"videos/{CAMERA}/file_index": "int64",
    f"videos/{CAMERA}/from_timestamp": "double", f"videos/{CAMERA}/to_timestamp": "double",
}  # fmt: skip
PUBLISHED_STATS = {"min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99"}


def arrow_type(feature: dict[str, Any]) -> str:
    """Type of a feature's column: one number of shape [1], else lists of lists."""
    named = {"float32": "float", "int64": "int64"}[feature["dtype"]]
    for size in reversed(feature["shape"] if feature["shape"] != [1] else []):
        named = f"fixed_size_list<element: {named}>[{size}]"
    return named


def test_lerobot_is_of_its_published_layout(
    tiny: Path, loaded: list[Loaded], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    export(tiny, "lerobot", out)
    info, stats = (
        json.loads((out / f"meta/{n}.json").read_text("utf-8")) for n in ("info", "stats")
    )
    features = info["features"]
    assert set(info) == PUBLISHED_INFO
    assert {name: features[name] for name in PUBLISHED_FEATURES} == PUBLISHED_FEATURES
    assert (features[MARKERS]["dtype"], features[MARKERS]["shape"]) == ("float32", [2, 400, 2])
    assert features[CAMERA]["info"]["is_depth_map"] is False
    data = pq.ParquetFile(out / "data/chunk-000/file-000.parquet")
    assert data.num_row_groups == 3  # one for each episode
    assert {field.name: str(field.type) for field in data.schema_arrow} == {
        name: arrow_type(each) for name, each in features.items() if name != CAMERA
    }
    episodes = pq.read_table(out / "meta/episodes/chunk-000/file-000.parquet")
    kinds = {field.name: str(field.type) for field in episodes.schema}
    assert {k: v for k, v in kinds.items() if not k.startswith("stats/")} == PUBLISHED_EPISODES
    assert set(kinds) - set(PUBLISHED_EPISODES) == {
        f"stats/{name}/{kind}" for name in features for kind in PUBLISHED_STATS
    }
    for name, each in features.items():  # one for each number of the last axis
        shape = (3, 1, 1) if name == CAMERA else tuple(each["shape"][-1:])
        assert {kind: np.shape(v) for kind, v in stats[name].items()} == dict.fromkeys(
            PUBLISHED_STATS, shape
        ) | {"count": (1,)}
    places = np.concatenate([one.places for one in loaded]).astype(np.float32)
    np.testing.assert_array_equal(data.read()[MARKERS].to_pylist(), places)
    flat = places.reshape(-1, 2).astype(float)
    for kind in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(stats[MARKERS][kind], getattr(flat, kind)(axis=0), rtol=1e-9)
    one = places[7:14].reshape(-1, 2).astype(float)
    quantile = episodes[f"stats/{MARKERS}/q10"].to_pylist()[1]
    np.testing.assert_allclose(quantile, np.quantile(one, 0.1, axis=0), rtol=1e-9)


def test_statistics_for_lerobot_pass_over_what_is_not_known(
    tiny: Path, loaded: list[Loaded], tmp_path: Path
) -> None:
    """A marker is missing, and one sequence has no contact: its margin is NaN."""
    first, second, _ = loaded
    markers = {**second.markers, "x_px": second.markers["x_px"].copy()}
    markers["x_px"][:, 5] = np.nan
    free = {**first.frames, "margin": np.full(7, np.nan)}
    changed = [replace(first, frames=free), replace(second, markers=markers)]
    write_lerobot(iter(changed), tmp_path, {"train": 2})
    stats = json.loads((tmp_path / "meta/stats.json").read_text("utf-8"))
    x = np.stack([first.markers["x_px"], second.markers["x_px"]]).astype(float)
    x[1, :, 5] = np.nan
    assert stats[MARKERS]["max"][0] == np.nanmax(x)
    known = second.frames["margin"].astype(np.float32).astype(float)
    at = FORCES.index("margin")
    for kind in ("min", "max", "mean", "std"):
        wanted = getattr(np, f"nan{kind}")(known)
        assert stats["label.forces"][kind][at] == pytest.approx(wanted, rel=1e-9)
    rows = pq.read_table(tmp_path / "data/chunk-000/file-000.parquet")[MARKERS].to_pylist()
    assert np.isnan(np.array(rows)[:, 0, 5, 0]).tolist() == [False] * 7 + [True] * 7


def test_lerobot_needs_one_number_of_markers(loaded: list[Loaded], tmp_path: Path) -> None:
    fewer = {name: loaded[1].markers[name][:, :790] for name in ("x_px", "y_px")}
    changed = [loaded[0], replace(loaded[1], markers=fewer)]
    said = "sequence 1 has 395 markers of each colour, not 400 markers"
    with pytest.raises(UserError, match=said):
        write_lerobot(iter(changed), tmp_path, {"train": 2})


@pytest.mark.filterwarnings("default")  # other people's
def test_lerobot_is_as_its_reader_takes_it(
    tiny: Path, loaded: list[Loaded], tmp_path: Path
) -> None:
    """Runs where LeRobot is installed, which brings some gigabytes along."""
    reader = pytest.importorskip("lerobot.datasets.lerobot_dataset")
    export(tiny, "lerobot", tmp_path / "out")
    read = reader.LeRobotDataset("local/tiny", root=tmp_path / "out", video_backend="pyav")
    assert (len(read), read.num_episodes, read.fps) == (21, 3, 60)
    for number in (0, 9, 20):
        item, one, t = read[number], loaded[number // 7], number % 7
        assert (int(item["episode_index"]), item["task"]) == (number // 7, one.values["motion"])
        np.testing.assert_array_equal(item[MARKERS].numpy(), one.places[t].astype(np.float32))
        x, y, z, *torque = item["observation.wrench"].tolist()
        assert (x, -z) == pytest.approx([one.frames[k][t] for k in ("friction_n", "normal_n")])
        assert (y, *torque) == (0.0, 0.0, 0.0, 0.0)
        forces = [one.frames[name][t] for name in FORCES]
        np.testing.assert_allclose(item["label.forces"].numpy(), forces, rtol=1e-6)
        picture = 255.0 * item[CAMERA].permute(1, 2, 0).numpy()
        assert np.sqrt(((picture - list(one.images())[t]) ** 2).mean()) < 4.0


@pytest.mark.parametrize("layout", [*LAYOUTS, "lerobot"])
def test_an_export_that_breaks_off_leaves_nothing(tiny: Path, tmp_path: Path, layout: str) -> None:
    def stop(done: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(tiny, layout, tmp_path / "out", stop)
    assert not list(tmp_path.iterdir())
    with pytest.raises(UserError, match="is no dataset"):
        export(tmp_path, layout, tmp_path / "out")


@pytest.fixture(scope="module")
def halves(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny dataset, split: one object is for tests."""
    folder = tmp_path_factory.mktemp("data") / "split"
    shutil.copytree(tiny, folder)
    parts = split(str(folder), {"train": 0.6, "test": 0.4}, seed=1, by="object")
    assert sorted(len(names) for names in parts.values()) == [1, 2]
    return folder


def test_every_layout_keeps_the_parts_of_a_split(halves: Path, tmp_path: Path) -> None:
    parts = json.loads((halves / "split.json").read_text("utf-8"))
    for layout in (*LAYOUTS, "lerobot"):
        export(str(halves), layout, str(tmp_path / layout))
    for part, names in parts.items():
        video = pickle.loads((tmp_path / "tapvid" / part / "tapvid-00000.pkl").read_bytes())
        assert sorted(video) == names
        coco = json.loads((tmp_path / "coco" / part / "annotations.json").read_text("utf-8"))
        assert len(coco["images"]) == len(coco["annotations"]) == 7 * len(names)
        assert {image["file_name"][:15] for image in coco["images"]} == set(names)
        with tarfile.open(tmp_path / "webdataset" / part / "frames-000000.tar") as tar:
            assert {f"sequence-{name[:6]}" for name in tar.getnames()} == set(names)
    info = json.loads((tmp_path / "lerobot" / "meta" / "info.json").read_text("utf-8"))
    table = pq.read_table(tmp_path / "lerobot/data/chunk-000/file-000.parquet")
    grips = np.stack(table["observation.state"].to_pylist())[:, 0]
    for part, names in parts.items():
        first, last = (int(number) for number in info["splits"][part].split(":"))
        expected = [one.frames["grip_n"] for one in load_sequences(str(halves), part)]
        assert last - first == len(names)
        np.testing.assert_allclose(grips[7 * first : 7 * last], np.concatenate(expected), rtol=1e-6)


def test_a_part_or_a_split_that_is_wrong_is_said(halves: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="has no part 'dev'; it has train, test"):
        list(load_sequences(halves, "dev"))
    shutil.copytree(halves, tmp_path / "more")
    (tmp_path / "more" / "split.json").write_text('{"train": ["sequence-000000"]}')
    with pytest.raises(UserError, match="each sequence of the dataset once"):
        export(tmp_path / "more", "coco", tmp_path / "out")


def test_what_has_changed_is_not_exported(tiny: Path, tmp_path: Path) -> None:
    shutil.copytree(tiny, tmp_path / "spoilt")
    (tmp_path / "spoilt" / "sequence-000001" / "frame-002.png").write_bytes(b"x")
    with pytest.raises(UserError, match=r"frame-002\.png has changed"):
        export(tmp_path / "spoilt", "webdataset", tmp_path / "out")
    assert not (tmp_path / "out").exists()
