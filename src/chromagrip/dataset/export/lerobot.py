"""A dataset in LeRobot's layout, version 3: tables of all frames, one video, and meta data."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...output.video import VideoFile
from ..labels import INTERVALS, STATES
from ..read import Loaded

if TYPE_CHECKING:
    import pyarrow as pa

#: Feature of the pictures.
CAMERA = "observation.images.tactile"
#: Feature of the markers: pixels of each layer's markers, right and down; NaN where one is missing.
MARKERS = "observation.markers"
#: Columns of a frame in the feature `observation.state`.
STATE = ("grip_n", "load_n", "rigid_part_mm", "object_mm")
#: Numbers of a frame in the feature `observation.wrench`, in the order of ROS.
WRENCH = ("force_x_n", "force_y_n", "force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm")
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
#: Smallest, largest, mean, deviation, count and quantiles of a feature; NaN where nothing is known.
Stats = dict[str, Array]
#: Quantiles among the statistics.
_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}


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
                for feature, stats in self.stats.items()
                for kind, values in _plain(stats).items()
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
        When the rate is no whole number, or rate, size of pictures or number of markers differ
        between sequences.
    """
    import pyarrow.parquet as pq

    data, video = out / f"data/{_FILE}.parquet", out / f"videos/{CAMERA}/{_FILE}.mp4"
    for path in (data, video):
        path.parent.mkdir(parents=True)
    episodes: list[Episode] = []
    tasks: list[str] = []
    size: _Size | None = None
    quality = 12  # rate factor of x264; lower is better
    keyframes = "2"  # pictures from one keyframe to the next, as in LeRobot's own videos
    sampled = 4  # pictures of a sequence that its colours' statistics are computed from
    with ExitStack() as files:
        for one in sequences:
            size = _one_size(one, size)
            task = str(one.values.get("motion", "press"))
            tasks += [] if task in tasks else [task]
            start = episodes[-1].end if episodes else 0
            columns = _columns(one, len(episodes), start, tasks.index(task))
            table = _table(columns)
            if not episodes:
                film = files.enter_context(VideoFile(video, size.rate, quality, {"g": keyframes}))
                rows = files.enter_context(pq.ParquetWriter(data, table.schema))
            rows.write_table(table)
            length = len(one.pictures)
            colours = []
            for t, image in enumerate(one.images()):
                film.append(image)
                if t % max(1, length // sampled) == 0:
                    colours.append(image.reshape(-1, 3) / 255.0)
            stats = {name: _stats(values) for name, values in columns.items()}
            stats[CAMERA] = _image_stats(np.concatenate(colours), len(colours))
            episodes.append(
                Episode(number=len(episodes), start=start, length=length, task=task, stats=stats)
            )
    assert size is not None
    _write_meta(out, [episode.row(size.rate) for episode in episodes], tasks)
    joined = {name: _plain(_joined([one.stats[name] for one in episodes])) for name in stats}
    _write_json(out, "stats", joined)
    _write_json(
        out, "info", _info(_features(columns, size), episodes, len(tasks), size.rate, parts)
    )


class _Size(NamedTuple):
    """What all sequences must have in common.

    Attributes
    ----------
    rate: frames per second
    height, width: of the pictures [px]
    markers: number of markers of each layer
    """

    rate: int
    height: int
    width: int
    markers: int


def _one_size(one: Loaded, before: _Size | None) -> _Size:
    """Size of a sequence, which must be that of the sequences before it."""
    rate, view = one.scene.camera.rate_hz, one.scene.build_sensor().view
    own = _Size(round(rate), view.height, view.width, one.places.shape[2])
    if rate != (before or own).rate:
        problem = f"{rate:g} frames a second; LeRobot wants one whole number for all"
    elif before and own[1:3] != before[1:3]:
        problem = f"pictures of {own.width}×{own.height} pixels; LeRobot wants one size for all"
    elif before and own.markers != before.markers:
        problem = (
            f"{own.markers} markers of each colour, others {before.markers}; LeRobot wants one "
            "number for all"
        )
    else:
        return own
    raise UserError(f"sequence {one.number} has {problem}")


def _columns(one: Loaded, episode: int, start: int, task: int) -> Columns:
    """Columns of an episode; those of one number a frame are flat."""
    length = len(one.pictures)
    frames = np.arange(length)

    def stacked(names: tuple[str, ...]) -> NDArray[np.float32]:
        return np.stack([one.frames[name] for name in names], axis=1).astype(np.float32)

    read = READ_FORCES[0] in one.frames
    return {
        "observation.state": stacked(STATE),
        MARKERS: one.places.astype(np.float32),
        "observation.wrench": _wrench(one).astype(np.float32),
        "action": stacked(_ACTION)[:, 0],
        "label.forces": stacked(FORCES),
        **({"reading.forces": stacked(READ_FORCES)} if read else {}),
        "label.slip_state": np.array([STATES.index(s) for s in one.frames["slip_state"]]),
        "timestamp": (frames / one.scene.camera.rate_hz).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.full(length, episode),
        "index": start + frames,
        "task_index": np.full(length, task),
    }


def _wrench(one: Loaded) -> Array:
    """True wrench of the object on the sensor as WRENCH, shape (T, 6).

    A chain has sums along and across its slice only; they are x and −z.
    """
    known = one.frames
    if WRENCH[0] in known:
        return np.stack(
            [1e-3 * known[f"{n}m"] if f"{n}m" in known else known[n] for n in WRENCH], axis=1
        )
    wrench = np.zeros((len(one.pictures), 6))
    wrench[:, 0], wrench[:, 2] = known["friction_n"], -known["normal_n"]
    return wrench


def _stats(values: NDArray[Any]) -> Stats:
    """Statistics over the rows in which a number is finite.

    As in LeRobot, those of an array of a frame are over all its axes but the last.
    """
    shape = values.shape[1:][-1:] or (1,)
    flat = values.reshape(-1, *shape).astype(float)
    flat[~np.isfinite(flat)] = np.nan
    known = np.isfinite(flat).any(axis=0)

    def of(function: Callable[[Array], Any]) -> Array:
        found = np.full(shape, np.nan)
        found[known] = function(flat[:, known])
        return found

    return {
        "min": of(partial(np.nanmin, axis=0)),
        "max": of(partial(np.nanmax, axis=0)),
        "mean": of(partial(np.nanmean, axis=0)),
        "std": of(partial(np.nanstd, axis=0)),
        "count": np.array([len(values)]),
        **{name: of(partial(np.nanquantile, q=q, axis=0)) for name, q in _QUANTILES.items()},
    }


def _image_stats(colours: Array, count: int) -> Stats:
    """Statistics of each colour over sampled pictures, whose number is their count."""
    found = {kind: values.reshape(-1, 1, 1) for kind, values in _stats(colours).items()}
    return {**found, "count": np.array([count])}


def _joined(parts: Sequence[Stats]) -> Stats:
    """Statistics of a feature over all episodes, each weighted by its count, as LeRobot joins them.

    That makes its quantiles approximate. Unknown statistics are 0.
    """
    of = {kind: np.ma.masked_invalid([part[kind] for part in parts]) for kind in parts[0]}
    over = partial(np.ma.average, axis=0, weights=of["count"][:, 0])
    mean = over(of["mean"])
    joined = {
        "min": of["min"].min(axis=0),
        "max": of["max"].max(axis=0),
        "mean": mean,
        "std": np.ma.sqrt(over(of["std"] ** 2 + (of["mean"] - mean) ** 2)),
        "count": of["count"].sum(axis=0),
        **{name: over(of[name]) for name in _QUANTILES},
    }
    return {kind: values.filled(0) for kind, values in joined.items()}


def _plain(stats: Stats) -> dict[str, list[Any]]:
    """Statistics as lists; unknown ones are 0."""
    return {kind: np.nan_to_num(values).tolist() for kind, values in stats.items()}


def _table(columns: Columns) -> "pa.Table":
    """Rows of an episode; an array of a frame is a list of lists."""
    import pyarrow as pa

    table = {}
    for name, values in columns.items():
        table[name] = pa.array(values.ravel())
        for size in reversed(values.shape[1:]):
            table[name] = pa.FixedSizeListArray.from_arrays(table[name], size)
    return pa.table(table)


def _write_meta(out: Path, episodes: list[dict[str, object]], tasks: list[str]) -> None:
    """Write the tables of the episodes and of the tasks."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = out / f"meta/episodes/{_FILE}.parquet"
    path.parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(episodes), path)
    pq.write_table(_tasks(tasks), out / "meta/tasks.parquet")


def _tasks(tasks: list[str]) -> "pa.Table":
    """Table of tasks, whose index in pandas is their names."""
    import pyarrow as pa

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


def _features(columns: Columns, size: _Size) -> dict[str, dict[str, object]]:
    """Type, shape and names of each feature."""
    names = {
        "observation.state": STATE, MARKERS: ("layer", "marker", "xy"),
        "observation.wrench": WRENCH, "action": _ACTION, "label.forces": FORCES,
        "reading.forces": READ_FORCES,
    }  # fmt: skip
    features: dict[str, dict[str, object]] = {
        CAMERA: {
            "dtype": "video",
            "shape": [size.height, size.width, 3],
            "names": ["height", "width", "channels"],
            "info": {
                "video.height": size.height,
                "video.width": size.width,
                "video.codec": "h264",
                "video.pix_fmt": "yuv444p",
                "video.fps": size.rate,
                "video.channels": 3,
                "is_depth_map": False,
                "has_audio": False,
            },
        }
    }
    for name, values in columns.items():
        own = names.get(name)
        features[name] = {
            "dtype": str(values.dtype),
            "shape": list(values.shape[1:] or (1,)),
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
