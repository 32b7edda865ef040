"""A dataset in LeRobot's layout, version 3: tables of all frames, one video, and meta data."""

import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...output.video import VideoFile
from ..labels import INTERVALS, STATES
from ..read import Loaded

#: Features of the pictures, and of the markers in pixels, right and down; NaN where one is missing.
CAMERA, MARKERS = "observation.images.tactile", "observation.markers"
#: Columns of a frame in features.
STATE = ("grip_n", "load_n", "rigid_part_mm", "object_mm")
FORCES = ("normal_n", "friction_n", "mu", "margin", "slipped_share")
READ_FORCES = tuple(name for columns in INTERVALS.values() for name in columns)
#: Numbers of the wrench, in the order of ROS.
WRENCH = ("force_x_n", "force_y_n", "force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm")
#: Names of the numbers of each feature.
_NAMES = {
    "observation.state": STATE, MARKERS: ("layer", "marker", "xy"), "observation.wrench": WRENCH,
    "action": ("grip_n",), "label.forces": FORCES, "reading.forces": READ_FORCES,
}  # fmt: skip
#: Name of every file: a dataset has one chunk with one file.
_FILE = "chunk-000/file-000"
#: What `meta/info.json` says of every dataset.
_INFO: dict[str, Any] = {
    "codebase_version": "v3.0", "robot_type": "chromagrip", "total_episodes": 0, "total_frames": 0,
    "total_tasks": 0, "chunks_size": 1000, "data_files_size_in_mb": 100,
    "video_files_size_in_mb": 200, "fps": 0, "splits": {},
    "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
}  # fmt: skip
#: Quantiles among the statistics.
_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

#: Columns of the table of frames, or statistics of a feature; NaN where nothing is known.
Arrays = dict[str, NDArray[Any]]


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
    episodes, tasks = list[dict[str, Any]](), list[str]()
    stats: list[dict[str, Arrays]] = []
    sizes: tuple[str, ...] = ()
    start = rate = 0
    quality, keyframes = 12, {"g": "2"}  # rate factor of x264; keyframes as in LeRobot's own videos
    sampled = 4  # pictures of a sequence that its colours' statistics are computed from
    with ExitStack() as files:
        for one in sequences:
            rate = rate or round(one.scene.camera.rate_hz)
            sizes = sizes or (f"{rate} frames a second", *_sizes(one)[1:])
            for own, other in zip(_sizes(one), sizes, strict=True):
                if own != other:
                    text = f"sequence {one.number} has {own}, not {other}"
                    raise UserError(f"{text}; LeRobot needs the same in all")
            task = str(one.values.get("motion", "press"))
            tasks += [] if task in tasks else [task]
            columns = _columns(one, len(episodes), start, tasks.index(task))
            table = _table(columns)
            if not episodes:
                film = files.enter_context(VideoFile(video, rate, quality, keyframes))
                rows = files.enter_context(pq.ParquetWriter(data, table.schema))
            rows.write_table(table)
            length, colours = len(one.pictures), []
            for t, image in enumerate(one.images()):
                film.append(image)
                if t % max(1, length // sampled) == 0:
                    colours.append(image.reshape(-1, 3) / 255.0)
            found = {name: _stats(values) for name, values in columns.items()}
            shown = _stats(np.concatenate(colours)).items()
            found[CAMERA] = {kind: values.reshape(-1, 1, 1) for kind, values in shown}
            found[CAMERA]["count"] = np.array([len(colours)])
            stats.append(found)
            episodes.append(_episode(len(episodes), start, length, rate, found) | {"tasks": [task]})
            start += length
    ends = dict(zip(parts, np.cumsum([*parts.values()]).tolist(), strict=True))
    splits = {name: f"{end - parts[name]}:{end}" for name, end in ends.items()}
    counts = {"total_episodes": len(episodes), "total_frames": start, "total_tasks": len(tasks)}
    features = _features(columns, image.shape, rate)
    info = _INFO | counts | {"fps": rate, "splits": splits, "features": features}
    _write_meta(out / "meta", episodes, tasks, stats, info)


def _write_meta(
    out: Path,
    episodes: list[dict[str, Any]],
    tasks: list[str],
    stats: list[dict[str, Arrays]],
    info: dict[str, Any],
) -> None:
    """Write the tables of episodes and tasks, the statistics over all, and what describes them."""
    import pandas as pd
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = out / f"episodes/{_FILE}.parquet"
    path.parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(episodes), path)
    index = pd.Index(tasks, name="task")
    pd.DataFrame({"task_index": range(len(tasks))}, index).to_parquet(out / "tasks.parquet")
    joined = {name: _joined([each[name] for each in stats]) for name in stats[0]}
    for name, content in (("stats", joined), ("info", info)):
        text = json.dumps(content, indent=4, ensure_ascii=False)
        (out / f"{name}.json").write_text(text + "\n", encoding="utf-8")


def _episode(
    number: int, start: int, length: int, rate: int, stats: dict[str, Arrays]
) -> dict[str, Any]:
    """Row of the table of episodes, whose tasks come later."""
    end, video = start + length, f"videos/{CAMERA}"
    return {
        "episode_index": number, "tasks": [], "length": length,
        "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
        "data/chunk_index": 0, "data/file_index": 0,
        "dataset_from_index": start, "dataset_to_index": end,
        f"{video}/chunk_index": 0, f"{video}/file_index": 0,
        f"{video}/from_timestamp": start / rate, f"{video}/to_timestamp": end / rate,
        **{
            f"stats/{feature}/{kind}": np.nan_to_num(values).tolist()
            for feature, of in stats.items()
            for kind, values in of.items()
        },
    }  # fmt: skip


def _sizes(one: Loaded) -> tuple[str, ...]:
    """Rate, size of the pictures and number of markers of a sequence, in words."""
    view = one.scene.build_sensor().view
    return (
        f"{one.scene.camera.rate_hz:g} frames a second",
        f"pictures of {view.width}×{view.height} pixels",
        f"{one.places.shape[2]} markers of each colour",
    )


def _columns(one: Loaded, episode: int, start: int, task: int) -> Arrays:
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
        "action": stacked(_NAMES["action"])[:, 0],
        "label.forces": stacked(FORCES),
        **({"reading.forces": stacked(READ_FORCES)} if read else {}),
        "label.slip_state": np.array([STATES.index(s) for s in one.frames["slip_state"]]),
        "timestamp": (frames / one.scene.camera.rate_hz).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.full(length, episode),
        "index": start + frames,
        "task_index": np.full(length, task),
    }


def _wrench(one: Loaded) -> NDArray[np.float64]:
    """True wrench of the object on the sensor, shape (T, 6); of a chain along x and −z alone."""
    known = one.frames
    if WRENCH[0] not in known:
        wrench = np.zeros((len(one.pictures), 6))
        wrench[:, 0], wrench[:, 2] = known["friction_n"], -known["normal_n"]
        return wrench
    return np.stack([1e-3 * known[f"{n}m"] if n[0] == "t" else known[n] for n in WRENCH], axis=1)


def _stats(values: NDArray[Any]) -> Arrays:
    """Statistics of finite numbers, over all axes but the last of a frame, as in LeRobot."""
    flat = values.reshape(-1, *(values.shape[1:][-1:] or (1,))).astype(float)
    flat[~np.isfinite(flat)] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of numbers that are never finite
        quantiles = np.nanquantile(flat, list(_QUANTILES.values()), axis=0)
        return {
            "min": np.nanmin(flat, axis=0), "max": np.nanmax(flat, axis=0),
            "mean": np.nanmean(flat, axis=0), "std": np.nanstd(flat, axis=0),
            "count": np.array([len(values)]), **dict(zip(_QUANTILES, quantiles, strict=True)),
        }  # fmt: skip


def _joined(parts: Sequence[Arrays]) -> dict[str, list[Any]]:
    """Statistics over all episodes, weighted by count as in LeRobot: quantiles are approximate."""
    of = {kind: np.ma.masked_invalid([part[kind] for part in parts]) for kind in parts[0]}
    over = partial(np.ma.average, axis=0, weights=of["count"][:, 0])
    mean = over(of["mean"])
    joined = {
        "min": of["min"].min(axis=0), "max": of["max"].max(axis=0), "mean": mean,
        "std": np.ma.sqrt(over(of["std"] ** 2 + (of["mean"] - mean) ** 2)),
        "count": of["count"].sum(axis=0), **{name: over(of[name]) for name in _QUANTILES},
    }  # fmt: skip
    return {kind: values.filled(0).tolist() for kind, values in joined.items()}


def _table(columns: Arrays) -> Any:
    """Rows of an episode; an array of a frame is a list of lists."""
    import pyarrow as pa

    table = {}
    for name, values in columns.items():
        table[name] = pa.array(values.ravel())
        for size in reversed(values.shape[1:]):
            table[name] = pa.FixedSizeListArray.from_arrays(table[name], size)
    return pa.table(table)


def _features(columns: Arrays, shape: tuple[int, ...], rate: int) -> dict[str, Any]:
    """Type, shape and names of the pictures, which are a video, and of each column."""
    video = {"height": shape[0], "width": shape[1], "codec": "h264", "pix_fmt": "yuv444p"}
    video |= {"fps": rate, "channels": 3}
    info = {f"video.{key}": value for key, value in video.items()}
    info |= {"is_depth_map": False, "has_audio": False}
    names: list[str] | None = ["height", "width", "channels"]
    features = {CAMERA: {"dtype": "video", "shape": list(shape), "names": names, "info": info}}
    for name, values in columns.items():
        names = list(_NAMES[name]) if name in _NAMES else None
        own = list(values.shape[1:] or (1,))
        features[name] = {"dtype": str(values.dtype), "shape": own, "names": names}
    return features
