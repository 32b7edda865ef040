"""A dataset in LeRobot's layout, version 3: tables of all frames, one video, and meta data."""

import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...extras import need
from ...output.video import VideoFile
from ..labels import INTERVALS, STATES
from ..read import Loaded

if TYPE_CHECKING:
    import pyarrow as pa

#: Feature of the pictures.
CAMERA = "observation.images.tactile"
#: Columns of a frame in the feature `observation.state`.
STATE = ("grip_n", "load_n", "rigid_part_mm", "object_mm")
#: Columns of a frame in the feature `label.forces`.
FORCES = ("normal_n", "friction_n", "mu", "margin", "slipped_share")
#: Columns of a frame in the feature `reading.forces`, where the dataset has a reading.
READ_FORCES = tuple(name for columns in INTERVALS.values() for name in columns)
#: Columns of a frame in the feature `action`.
_ACTION = ("grip_n",)
#: Name of every file: a dataset has one chunk with one file.
_FILE = "chunk-000/file-000"

Array = NDArray[np.float64]
#: Columns of the table of frames.
Columns = dict[str, NDArray[Any]]
#: Smallest, largest, mean, deviation and count of a feature.
Stats = dict[str, list[Any]]


@dataclass(frozen=True, kw_only=True)
class Episode:
    """A sequence in LeRobot's list of episodes.

    Attributes
    ----------
    number: number of the episode
    start: index of its first frame in the dataset
    length: number of its frames
    task: description of the task
    stats: statistics by feature
    """

    number: int
    start: int
    length: int
    task: str
    stats: dict[str, Stats]

    @property
    def end(self) -> int:
        """Index after that of its last frame."""
        return self.start + self.length

    def row(self, rate: int) -> dict[str, object]:
        """Row of the table of episodes; `rate` is in frames per second."""
        return {
            "episode_index": self.number,
            "tasks": [self.task],
            "length": self.length,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": self.start,
            "dataset_to_index": self.end,
            f"videos/{CAMERA}/chunk_index": 0,
            f"videos/{CAMERA}/file_index": 0,
            f"videos/{CAMERA}/from_timestamp": self.start / rate,
            f"videos/{CAMERA}/to_timestamp": self.end / rate,
            **{
                f"stats/{feature}/{kind}": values
                for feature, kinds in self.stats.items()
                for kind, values in kinds.items()
            },
        }


def write_lerobot(sequences: Iterator[Loaded], out: Path, parts: Mapping[str, int]) -> None:
    """Write meta, data and videos; each sequence is an episode, its motion the task.

    Parameters
    ----------
    sequences: those of the first part first
    out: folder
    parts: numbers of sequences of the splits, in order

    Raises
    ------
    UserError
        When the rate is no whole number, or rate or size of pictures differ between sequences.
    """
    video = out / "videos" / CAMERA / f"{_FILE}.mp4"
    video.parent.mkdir(parents=True)
    tables: list[Columns] = []
    episodes: list[Episode] = []
    tasks: list[str] = []
    film: VideoFile | None = None
    rate, shape, start = 0, (0, 0, 3), 0
    quality = 12  # rate factor of x264; lower is better
    keyframes = "2"  # pictures from one keyframe to the next, as in LeRobot's own videos
    sampled = 4  # pictures of a sequence that its colours' mean and spread are computed from
    with ExitStack() as files:
        for one in sequences:
            own = one.scene.camera.rate_hz
            rate = rate or round(own)
            if own != rate:
                raise UserError(
                    f"sequence {one.number} has {own:g} frames a second; LeRobot wants one whole "
                    "number for all"
                )
            if film is None:
                film = files.enter_context(VideoFile(video, rate, quality, {"g": keyframes}))
            task = str(one.values.get("motion", "press"))
            tasks += [] if task in tasks else [task]
            length = len(one.pictures)
            colours = []
            for t, image in enumerate(one.images()):
                shape = _one_shape(image, shape, one.number)
                film.append(image)
                if t % max(1, length // sampled) == 0:
                    colours.append(image.reshape(-1, 3) / 255.0)
            columns = _columns(one, len(episodes), start, tasks.index(task))
            tables.append(columns)
            stats = {name: _stats(values) for name, values in columns.items()}
            stats[CAMERA] = _image_stats(np.concatenate(colours), len(colours))
            episodes.append(
                Episode(number=len(episodes), start=start, length=length, task=task, stats=stats)
            )
            start += length
    rows = [episode.row(rate) for episode in episodes]
    _write_tables(out, tables, rows, tasks)
    stats = {name: _stats(np.concatenate([part[name] for part in tables])) for name in tables[0]}
    _write_json(out, "stats", stats | {CAMERA: _joined(episodes)})
    _write_json(
        out, "info", _info(_features(columns, rate, shape), episodes, len(tasks), rate, parts)
    )


def _one_shape(
    image: NDArray[np.uint8], before: tuple[int, int, int], number: int
) -> tuple[int, int, int]:
    """Shape of a picture, which must be that of those before, (0, 0, 3) where there are none."""
    height, width, _ = image.shape
    if before not in ((0, 0, 3), image.shape):
        raise UserError(
            f"sequence {number} has pictures of {width}×{height} pixels; LeRobot wants one size "
            "for all"
        )
    return height, width, 3


def _columns(one: Loaded, episode: int, start: int, task: int) -> Columns:
    """Columns of an episode; those of one number a frame are flat."""
    length = len(one.pictures)
    frames = np.arange(length)

    def stacked(names: tuple[str, ...]) -> NDArray[np.float32]:
        return np.stack([one.frames[name] for name in names], axis=1).astype(np.float32)

    read = READ_FORCES[0] in one.frames
    return {
        "observation.state": stacked(STATE),
        "action": stacked(_ACTION),
        "label.forces": stacked(FORCES),
        **({"reading.forces": stacked(READ_FORCES)} if read else {}),
        "label.slip_state": np.array([STATES.index(s) for s in one.frames["slip_state"]]),
        "timestamp": (frames / one.scene.camera.rate_hz).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.full(length, episode),
        "index": start + frames,
        "task_index": np.full(length, task),
    }


def _stats(values: NDArray[Any]) -> Stats:
    """Statistics of each number, over the rows in which all are finite."""
    flat = values.reshape(len(values), -1).astype(float)
    known = np.isfinite(flat).all(axis=1)
    flat = flat[known] if known.any() else np.zeros_like(flat)
    return {
        "min": flat.min(axis=0).tolist(),
        "max": flat.max(axis=0).tolist(),
        "mean": flat.mean(axis=0).tolist(),
        "std": flat.std(axis=0).tolist(),
        "count": [len(flat)],
    }


def _image_stats(colours: Array, count: int) -> Stats:
    found = {
        k: np.reshape(v, (3, 1, 1)).tolist() for k, v in _stats(colours).items() if k != "count"
    }
    return {**found, "count": [count]}


def _write_tables(
    out: Path,
    parts: list[Columns],
    episodes: list[dict[str, object]],
    tasks: list[str],
) -> None:
    pa, pq = need("pyarrow", "data"), need("pyarrow.parquet", "data")
    columns = {}
    for name in parts[0]:
        values = np.concatenate([part[name] for part in parts])
        flat = pa.array(values.ravel())
        wide = values.ndim == 2 and values.shape[1] > 1
        columns[name] = pa.FixedSizeListArray.from_arrays(flat, values.shape[1]) if wide else flat
    for where, table in (
        (f"data/{_FILE}.parquet", pa.table(columns)),
        (f"meta/episodes/{_FILE}.parquet", pa.Table.from_pylist(episodes)),
        ("meta/tasks.parquet", _tasks(tasks)),
    ):
        path = out / where
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(table, path)


def _tasks(tasks: list[str]) -> "pa.Table":
    """Table of tasks, whose index in pandas is their names."""
    pa = need("pyarrow", "data")
    table = pa.table({"task_index": list(range(len(tasks))), "task": tasks})
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            {
                "name": name,
                "field_name": name,
                "pandas_type": kind,
                "numpy_type": stored,
                "metadata": None,
            }
            for name, kind, stored in (
                ("task_index", "int64", "int64"),
                ("task", "unicode", "object"),
            )
        ],
        "pandas_version": "2.0.0",
    }
    return table.replace_schema_metadata({b"pandas": json.dumps(pandas).encode()})


def _features(
    columns: Columns, rate: int, shape: tuple[int, int, int]
) -> dict[str, dict[str, object]]:
    """Type, shape and names of each feature; `shape` is that of the pictures."""
    names = {
        "observation.state": STATE, "action": _ACTION, "label.forces": FORCES,
        "reading.forces": READ_FORCES,
    }  # fmt: skip
    features: dict[str, dict[str, object]] = {
        CAMERA: {
            "dtype": "video",
            "shape": list(shape),
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": shape[0],
                "video.width": shape[1],
                "video.codec": "h264",
                "video.pix_fmt": "yuv444p",
                "video.is_depth_map": False,
                "video.fps": rate,
                "video.channels": 3,
                "has_audio": False,
            },
        }
    }
    for name, values in columns.items():
        own = names.get(name)
        features[name] = {
            "dtype": str(values.dtype),
            "shape": [len(own) if own else 1],
            "names": list(own) if own else None,
        }
    return features


def _info(
    features: dict[str, dict[str, object]],
    episodes: list[Episode],
    tasks: int,
    rate: int,
    parts: Mapping[str, int],
) -> dict[str, object]:
    ends = np.cumsum(list(parts.values())).tolist()
    return {
        "codebase_version": "v3.0",
        "robot_type": "chromagrip",
        "total_episodes": len(episodes),
        "total_frames": episodes[-1].end,
        "total_tasks": tasks,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": rate,
        "splits": {
            name: f"{end - size}:{end}"
            for (name, size), end in zip(parts.items(), ends, strict=True)
        },
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": features,
    }


def _write_json(out: Path, name: str, content: Mapping[str, object]) -> None:
    text = json.dumps(content, indent=4, ensure_ascii=False)
    (out / "meta" / f"{name}.json").write_text(text + "\n", encoding="utf-8")


def _joined(episodes: list[Episode]) -> Stats:
    """Colours of all episodes, each weighted by the pictures it was sampled in."""

    def of(kind: str) -> Array:
        return np.array([episode.stats[CAMERA][kind] for episode in episodes], dtype=float)

    weight = of("count").reshape(-1, 1, 1, 1)
    mean = (weight * of("mean")).sum(axis=0) / weight.sum()
    square = (weight * (of("std") ** 2 + of("mean") ** 2)).sum(axis=0) / weight.sum()
    return {
        "min": of("min").min(axis=0).tolist(),
        "max": of("max").max(axis=0).tolist(),
        "mean": mean.tolist(),
        "std": np.sqrt(np.maximum(square - mean**2, 0.0)).tolist(),
        "count": [int(weight.sum())],
    }
