"""What each exporter writes, read back as others read it, is what the dataset has."""

import json
import pickle
import shutil
import tarfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from msgspec import structs

from chromagrip import UserError
from chromagrip.dataset import Loaded, load_sequences
from chromagrip.dataset.export.layouts import LAYOUTS, export
from chromagrip.dataset.export.lerobot import (
    CAMERA,
    FORCES,
    MARKERS,
    READ_FORCES,
    STATE,
    write_lerobot,
)
from chromagrip.dataset.make import make
from chromagrip.dataset.recipe import load_recipe
from chromagrip.dataset.split import split

ALL = (*LAYOUTS, "lerobot")
FRAMES = 3


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny dataset with fewer and smaller pictures; not to be changed."""
    recipe, folder = load_recipe("tiny"), tmp_path_factory.mktemp("data") / "small"
    scene = recipe.scene | {"sensor": "dome-2020", "duration_s": 0.04}
    make(structs.replace(recipe, scene=scene), folder)
    return folder


@pytest.fixture(scope="module")
def loaded(small: Path) -> list[Loaded]:
    found = list(load_sequences(small))
    assert [len(one.pictures) for one in found] == [FRAMES] * 3
    return found


@pytest.fixture(scope="module")
def halves(small: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, split: one object is for tests."""
    folder = tmp_path_factory.mktemp("data") / "split"
    shutil.copytree(small, folder)
    parts = split(str(folder), {"train": 0.6, "test": 0.4}, seed=1, by="object")
    assert sorted(len(names) for names in parts.values()) == [1, 2]
    return folder


def of_tapvid(out: Path, sequences: Sequence[Loaded]) -> None:
    """Points of 0 to 1 of the video lie on the markers that it shows at some time."""
    found = pickle.loads((out / "tapvid-00000.pkl").read_bytes())
    assert list(found) == [f"sequence-{one.number:06d}" for one in sequences]
    for one, said in zip(sequences, found.values(), strict=True):
        video, points, occluded = said["video"], said["points"], said["occluded"]
        np.testing.assert_array_equal(video, list(one.images()))
        visible = one.visible.reshape(len(video), -1)
        ever = visible.any(axis=0)
        np.testing.assert_array_equal(occluded, ~visible.T[ever])
        assert ((points >= 0.0) & (points <= 1.0))[~occluded].all()
        places = np.swapaxes(one.places.reshape(len(video), -1, 2), 0, 1)[ever]
        back = points * [video.shape[2], video.shape[1]] - 0.5
        np.testing.assert_allclose(back[~occluded], places[~occluded], atol=1e-4)


def of_coco(out: Path, sequences: Sequence[Loaded]) -> None:
    read = pytest.importorskip("pycocotools.coco").COCO(str(out / "annotations.json"))
    (category,) = read.loadCats(read.getCatIds())
    numbers = iter(sorted(read.getImgIds()))
    for one in sequences:
        for t, picture in enumerate(one.images()):
            (image,) = read.loadImgs(next(numbers))
            shown = cv2.imread(str(out / "images" / image["file_name"]), cv2.IMREAD_COLOR_RGB)
            assert (image["height"], image["width"], 3) == picture.shape
            np.testing.assert_array_equal(shown, picture)
            (found,) = read.loadAnns(read.getAnnIds(image["id"]))
            points, visible = np.reshape(found["keypoints"], (-1, 3)), one.visible[t].ravel()
            assert len(points) == len(category["keypoints"])
            np.testing.assert_array_equal(points[:, 2], 2 * visible)
            seen = one.places[t].reshape(-1, 2)[visible]
            np.testing.assert_allclose(points[visible, :2], seen, atol=1e-3)
            assert found["num_keypoints"] == visible.sum()
            box = [*(seen.min(axis=0) + 0.5), *np.ptp(seen, axis=0)]
            np.testing.assert_allclose(found["bbox"], box, atol=2e-3)
    assert next(numbers, None) is None


def of_webdataset(out: Path, sequences: Sequence[Loaded]) -> None:
    path = out / "frames-000000.tar"
    with tarfile.open(path) as tar:
        assert {(m.mtime, m.uid, m.uname) for m in tar.getmembers()} == {(0, 0, "")}
    reader = pytest.importorskip("webdataset")
    samples = iter(list(reader.WebDataset(str(path), shardshuffle=False).decode("rgb8")))
    for one in sequences:
        for t, picture in enumerate(one.images()):
            found = next(samples)
            assert found["__key__"] == f"{one.number:06d}-{t:03d}"
            np.testing.assert_array_equal(found["png"], picture)
            assert found["json"]["sequence"] == one.number
            for name, column in one.frames.items():
                value, told = column[t], found["json"][name]
                missing = isinstance(value, float) and not np.isfinite(value)
                assert told is None if missing else told == value
            assert {*found["npz"]} == {*one.markers}
            for name, column in one.markers.items():
                np.testing.assert_array_equal(found["npz"][name], column[t])
    assert next(samples, None) is None


def wrench(one: Loaded) -> np.ndarray:
    """Force [N] and torque [N m] by axis; of a chain friction is along x, pressure against z."""
    frames = one.frames
    if "force_x_n" not in frames:
        nil = np.zeros(len(one.pictures))
        return np.stack([frames["friction_n"], nil, -frames["normal_n"], nil, nil, nil], axis=1)
    force = [frames[f"force_{axis}_n"] for axis in "xyz"]
    return np.stack([*force, *(1e-3 * frames[f"torque_{axis}_nmm"] for axis in "xyz")], axis=1)


def of_lerobot(out: Path, sequences: Sequence[Loaded]) -> None:
    """Each frame of an episode is found by its time in the video, nearly as it was."""
    info = json.loads((out / "meta" / "info.json").read_text("utf-8"))
    data = pq.read_table(out / info["data_path"].format(chunk_index=0, file_index=0))
    assert info["total_episodes"] == len(sequences)
    assert data["index"].to_pylist() == list(range(info["total_frames"]))
    assert set(data.column_names) == set(info["features"]) - {CAMERA}
    read = {name: np.array(data[name].to_pylist()) for name in data.column_names}
    for feature, names in (("observation.state", STATE), ("label.forces", FORCES)):
        labels = [np.concatenate([one.frames[name] for one in sequences]) for name in names]
        np.testing.assert_allclose(read[feature].T, labels, rtol=1e-6)
    places = np.concatenate([one.places for one in sequences])
    np.testing.assert_array_equal(read[MARKERS], places.astype(np.float32))
    forces = np.concatenate([wrench(one) for one in sequences])
    np.testing.assert_allclose(read["observation.wrench"], forces, rtol=1e-6, atol=1e-12)
    episodes = pq.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    path = out / info["video_path"].format(video_key=CAMERA, chunk_index=0, file_index=0)
    rate = info["fps"]
    with av.open(str(path)) as video:
        stream = video.streams.video[0]
        assert (stream.codec_context.pix_fmt, stream.average_rate) == ("yuv444p", rate)
        shown = {round(f.time * rate): f.to_ndarray(format="rgb24") for f in video.decode(stream)}
    for one, episode in zip(sequences, episodes, strict=True):
        assert episode["tasks"] == [one.values["motion"]]
        start = round(episode[f"videos/{CAMERA}/from_timestamp"] * rate)
        assert start == episode["dataset_from_index"]
        for t, image in enumerate(one.images()):
            error = shown[start + t].astype(float) - image
            assert np.sqrt((error**2).mean()) < 6.0  # of a noisy picture with fine structure


#: Readers of each layout, which compare what they read with sequences.
READERS: dict[str, Callable[[Path, Sequence[Loaded]], None]] = {
    "tapvid": of_tapvid, "coco": of_coco, "webdataset": of_webdataset, "lerobot": of_lerobot,
}  # fmt: skip
LAYOUT = pytest.mark.parametrize("layout", ALL)
pytestmark = pytest.mark.filterwarnings(  # webdataset's
    "ignore::pytest.PytestUnraisableExceptionWarning"
)


@LAYOUT
def test_an_export_is_the_dataset_or_nothing(
    small: Path, loaded: list[Loaded], tmp_path: Path, layout: str
) -> None:
    def stop(done: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(small, layout, tmp_path / "out", stop)
    assert not list(tmp_path.iterdir())
    files = export(small, layout, tmp_path / "out")
    assert files == sorted(path for path in (tmp_path / "out").rglob("*") if path.is_file())
    READERS[layout](tmp_path / "out", loaded)
    with pytest.raises(UserError, match="is not empty"):
        export(small, layout, tmp_path / "out")


@LAYOUT
def test_an_export_keeps_the_parts_of_a_split(halves: Path, tmp_path: Path, layout: str) -> None:
    export(str(halves), layout, str(tmp_path / "out"))
    parts = {part: list(load_sequences(halves, part)) for part in ("train", "test")}
    if layout == "lerobot":
        of_lerobot(tmp_path / "out", [*parts["train"], *parts["test"]])
        info = json.loads((tmp_path / "out" / "meta" / "info.json").read_text("utf-8"))
        first = len(parts["train"])
        assert info["splits"] == {"train": f"0:{first}", "test": f"{first}:3"}
        return
    for part, sequences in parts.items():
        READERS[layout](tmp_path / "out" / part, sequences)


def test_what_is_spoilt_is_not_exported(halves: Path, tmp_path: Path) -> None:
    spoilt = shutil.copytree(halves, tmp_path / "spoilt")
    (spoilt / "sequence-000001" / "frame-002.png").write_bytes(b"x")
    for folder, words in ((spoilt, r"frame-002\.png has changed"), (tmp_path, "is no dataset")):
        with pytest.raises(UserError, match=words):
            export(folder, "coco", tmp_path / "out")
    (spoilt / "split.json").write_text('{"train": ["sequence-000000"]}')
    with pytest.raises(UserError, match="each sequence of the dataset once"):
        export(spoilt, "coco", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.data
def test_forces_and_readings_of_a_dome_are_exported(pressed: Path, tmp_path: Path) -> None:
    sequences = list(load_sequences(pressed))
    for layout in ("webdataset", "lerobot"):
        export(pressed, layout, tmp_path / layout)
        READERS[layout](tmp_path / layout, sequences)
    info = json.loads((tmp_path / "lerobot" / "meta" / "info.json").read_text("utf-8"))
    assert info["features"]["reading.forces"]["names"] == list(READ_FORCES)
    table = pq.read_table(tmp_path / "lerobot" / "data/chunk-000/file-000.parquet")
    told = np.array(table["reading.forces"].to_pylist()).T
    wanted = [np.concatenate([one.frames[name] for one in sequences]) for name in READ_FORCES]
    np.testing.assert_allclose(told, wanted, rtol=1e-6)


#: Layout that LeRobot 0.6.1 writes for the same features: keys of `meta/info.json`, its own
#: features, columns of the episodes, and kinds of statistics.
PUBLISHED_INFO = {
    "codebase_version", "fps", "features", "total_episodes", "total_frames", "total_tasks",
    "chunks_size", "data_files_size_in_mb", "video_files_size_in_mb", "data_path", "video_path",
    "robot_type", "splits",
}  # fmt: skip
PUBLISHED_FEATURES = {"timestamp": {"dtype": "float32", "shape": [1], "names": None}} | {
    name: {"dtype": "int64", "shape": [1], "names": None}
    for name in ("frame_index", "episode_index", "index", "task_index")
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
    small: Path, loaded: list[Loaded], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    export(small, "lerobot", out)
    info, stats = (
        json.loads((out / f"meta/{n}.json").read_text("utf-8")) for n in ("info", "stats")
    )
    features = info["features"]
    assert (set(info), info["codebase_version"]) == (PUBLISHED_INFO, "v3.0")
    assert {name: features[name] for name in PUBLISHED_FEATURES} == PUBLISHED_FEATURES
    shape = list(loaded[0].places.shape[1:])
    assert (features[MARKERS]["dtype"], features[MARKERS]["shape"]) == ("float32", shape)
    assert features[CAMERA]["info"]["is_depth_map"] is False
    data = pq.ParquetFile(out / "data/chunk-000/file-000.parquet")
    assert data.num_row_groups == 3  # one for each episode
    assert {field.name: str(field.type) for field in data.schema_arrow} == {
        name: arrow_type(each) for name, each in features.items() if name != CAMERA
    }
    tasks = pq.read_table(out / "meta/tasks.parquet")
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
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
    flat = places.reshape(-1, 2).astype(float)
    for kind in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(
            stats[MARKERS][kind], getattr(np, f"nan{kind}")(flat, axis=0), rtol=1e-9
        )
    quantile = episodes[f"stats/{MARKERS}/q10"].to_pylist()[1]
    one = places[FRAMES : 2 * FRAMES].reshape(-1, 2).astype(float)
    np.testing.assert_allclose(quantile, np.nanquantile(one, 0.1, axis=0), rtol=1e-9)


def test_statistics_for_lerobot_pass_over_what_is_not_known(
    loaded: list[Loaded], tmp_path: Path
) -> None:
    """A marker is missing, and one sequence has no contact: its margin is NaN."""
    first, second, _ = loaded
    markers = {**second.markers, "x_px": second.markers["x_px"].copy()}
    markers["x_px"][:, 5] = np.nan
    free = {**first.frames, "margin": np.full(FRAMES, np.nan)}
    changed = [replace(first, frames=free), replace(second, markers=markers)]
    write_lerobot(iter(changed), tmp_path / "out", {"train": 2})
    stats = json.loads((tmp_path / "out/meta/stats.json").read_text("utf-8"))
    x = np.stack([one.markers["x_px"] for one in changed]).astype(float)
    assert stats[MARKERS]["max"][0] == np.nanmax(x)
    known = second.frames["margin"].astype(np.float32).astype(float)
    found = stats["label.forces"]["std"][FORCES.index("margin")]
    assert found == pytest.approx(np.nanstd(known), rel=1e-9)
    rows = pq.read_table(tmp_path / "out/data/chunk-000/file-000.parquet")[MARKERS].to_pylist()
    assert np.isnan(np.array(rows)[:, 0, 5, 0]).tolist() == [False] * FRAMES + [True] * FRAMES


def test_items_for_torch_are_those_of_the_dataset(
    halves: Path, pressed: Path, loaded: list[Loaded]
) -> None:
    """Where PyTorch is installed: a wheel of some hundred megabytes."""
    torch = pytest.importorskip("torch")
    from chromagrip.dataset.torch import Frames

    names = ("margin", "normal_n", "x_px", "visible", "slip_state")
    frames = Frames(str(halves), labels=names, with_rest=True)
    assert len(frames) == 3 * FRAMES
    for index in (0, 4, 8, -1):
        item, one, t = frames[index], loaded[index // FRAMES], index % FRAMES
        assert (item["sequence"], item["frame"]) == (one.number, t)
        assert (item["image"].numpy().transpose(1, 2, 0) == list(one.images())[t]).all()
        assert item["x_px"].dtype == torch.float32
        for name in ("margin", "normal_n", "x_px", "visible"):
            wanted = {**one.markers, **one.frames}[name][t]
            np.testing.assert_allclose(item[name].numpy(), wanted, rtol=1e-6)
    with pytest.raises(IndexError):
        frames[3 * FRAMES]
    noisy, clean = Frames(halves, "train", noise=8.0, seed=3), Frames(halves, "train")
    assert len(noisy) + len(Frames(halves, "test")) == 3 * FRAMES
    loader = torch.utils.data.DataLoader(noisy, batch_size=5, num_workers=2)
    batches = torch.cat([batch["image"] for batch in loader])
    assert all((batches[k] == noisy[k]["image"]).all() for k in range(len(noisy)))
    off = noisy[1]["image"].float() - clean[1]["image"].float()
    within = clean[1]["image"] < 220  # where nothing is clipped
    within &= clean[1]["image"] > 40
    assert off[within].std() == pytest.approx(8.0, rel=0.1)
    dense = Frames(pressed, labels=("depth", "reading_normal_n"))[1]
    depth = np.load(pressed / "sequence-000000" / "truth-001.npz")["depth"]
    np.testing.assert_array_equal(dense["depth"].numpy(), depth)
    for folder, words, said in (
        (halves, {"labels": ("flow",)}, r"no label 'flow' in .*; there is frame, time_s"),
        (pressed, {"labels": ("reading_no_estimate",)}, "'reading_no_estimate' is words"),
    ):
        with pytest.raises(UserError, match=said):
            Frames(folder, **words)
