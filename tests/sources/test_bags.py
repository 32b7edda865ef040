"""ROS 2 bags, written by another library: their pictures, times and topics, and damaged ones."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from chromagrip import UserError
from chromagrip.render import Frame
from chromagrip.sources import Source, open_source

rosbags = pytest.importorskip("rosbags")
from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
#: Pictures that a bag must give back, not square.
PICTURES = np.random.default_rng(3).integers(0, 256, (4, 6, 9, 3), dtype=np.uint8)
#: Columns of red, green and blue in the bytes of each encoding; grey is of its own.
COLUMNS = {"rgb8": "rgb", "bgr8": "bgr", "rgba8": "rgba", "bgra8": "bgra"}


def stamped(instant: float) -> Any:
    seconds = int(instant)
    stamp = TYPES["builtin_interfaces/msg/Time"](seconds, round(1e9 * (instant - seconds)))
    return TYPES["std_msgs/msg/Header"](stamp, "finger")


def raw(image: np.ndarray, encoding: str, instant: float, pad: int = 0) -> Any:
    """A message of an encoding, its rows longer by some bytes."""
    height, width = image.shape[:2]
    planes = {"r": image[..., 0], "g": image[..., 1], "b": image[..., 2]}
    planes["a"] = np.full((height, width), 7, np.uint8)
    columns = [planes["r"]] if encoding == "mono8" else [planes[c] for c in COLUMNS[encoding]]
    rows = np.stack(columns, axis=-1).reshape(height, -1)
    rows = np.pad(rows, ((0, 0), (0, pad)), constant_values=99)
    data, step = rows.reshape(-1), rows.shape[1]
    return TYPES[RAW](stamped(instant), height, width, encoding, 0, step, data)


def compressed(image: np.ndarray, kind: str, instant: float) -> Any:
    data = cv2.imencode(f".{kind}", image[..., ::-1])[1].reshape(-1)
    return TYPES[COMPRESSED](stamped(instant), f"rgb8; {kind} compressed bgr8", data)


#: Messages of a topic: the time of the log [s] and the message.
Messages = list[tuple[float, Any]]


def bag(folder: Path, storage: StoragePlugin = StoragePlugin.MCAP, **topics: Messages) -> Path:
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        for topic, messages in topics.items():
            kind = messages[0][1].__msgtype__
            connection = writer.add_connection(f"/finger/{topic}", kind, typestore=STORE)
            for logged, message in messages:
                writer.write(connection, int(1e9 * logged), STORE.serialize_cdr(message, kind))
    return folder


def images(encoding: str = "rgb8", **more: Any) -> Messages:
    return [(1.0 + k, raw(image, encoding, 50.0 + 0.1 * k, **more)) for k, image in
            enumerate(PICTURES)]  # fmt: skip


def read(source: Source) -> tuple[np.ndarray, list[float]]:
    frames = list(source.frames())
    return np.array([frame.image for frame in frames]), [frame.time for frame in frames]


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_folder_and_file_are_the_same(storage: StoragePlugin, tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", storage, image=images(), info=[(1.0, stamped(0.0))])
    (file,) = [p for p in folder.iterdir() if p.suffix in (".mcap", ".db3")]
    alone = tmp_path / file.name
    alone.write_bytes(file.read_bytes())
    for path in (folder, alone):
        source = open_source(str(path))
        assert (source.count, source.lossy) == (4, False)
        assert source.fps == pytest.approx(1.0)  # of the log
        pictures, times = read(source)
        np.testing.assert_array_equal(pictures, PICTURES)
        assert times == pytest.approx([0.0, 0.1, 0.2, 0.3])


@pytest.mark.parametrize("encoding", [*COLUMNS, "mono8"])
def test_encodings_with_longer_rows(encoding: str, tmp_path: Path) -> None:
    pictures, _ = read(open_source(str(bag(tmp_path / "bag", image=images(encoding, pad=5)))))
    wanted = PICTURES[..., :1].repeat(3, axis=-1) if encoding == "mono8" else PICTURES
    np.testing.assert_array_equal(pictures, wanted)


def test_compressed_pictures(tmp_path: Path) -> None:
    smooth = np.full((32, 48, 3), (200, 90, 30), np.uint8)
    for kind, off in (("png", 0.0), ("jpeg", 3.0)):
        messages: Messages = [(1.0, compressed(smooth, kind, 1.0))]
        source = open_source(str(bag(tmp_path / kind, image=messages)))
        assert source.lossy == (kind == "jpeg")
        assert np.abs(read(source)[0][0].astype(float) - smooth).max() <= off


def test_times_are_those_of_the_log_where_no_stamp_is(tmp_path: Path) -> None:
    messages = [(2.0 + k * k, raw(image, "rgb8", 0.0)) for k, image in enumerate(PICTURES)]
    folder = bag(tmp_path / "bag", image=messages)
    assert read(open_source(str(folder)))[1] == pytest.approx([0.0, 1.0, 4.0, 9.0])
    given = open_source(str(folder), fps=20.0)
    assert read(given)[1] == pytest.approx([0.0, 0.05, 0.1, 0.15])
    assert (given.fps, given.timed) == (20.0, False)


def test_one_of_several_topics(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", left=images(), right=images("bgr8")[1:])
    source = open_source(f'{folder}(topic = "/finger/right")')
    np.testing.assert_array_equal(read(source)[0], PICTURES[1:])


def left(words: str = "", **more: Messages) -> Callable[[Path], str]:
    return lambda folder: f"{bag(folder / 'bag', left=images(), **more)}{words}"


def third(**changes: Any) -> Callable[[Path], Path]:
    """Bag whose third message has other values."""

    def make(folder: Path) -> Path:
        messages = images()
        for name, value in changes.items():
            object.__setattr__(messages[2][1], name, value)
        return bag(folder / "bag", image=messages)

    return make


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (left(right=images()), r"has pictures in /finger/left, /finger/right; give one .*left\)$"),
        (left("(topic=/finger/lef)"), r"no pictures in topic /finger/lef \(did you mean /finger/l"),
        (left("(topik=/finger/left)"), r"has no argument topik \(did you mean topic\?\); it has"),
        (lambda folder: bag(folder / "bag", info=[(1.0, stamped(0.0))]),
         r"has no pictures \(sensor_msgs/msg/Image or .*\); it has /finger/info \(std_msgs"),
        (third(encoding="16UC1"), "encoding 16UC1; wanted: rgb8, bgr8, mono8, rgba8, bgra8"),
        (third(height=7), r"message 2 of /finger/image in .* has 162 bytes for 9×7 pixels"),
        (third(width=10**6, height=10**6), "megapixels; allowed: 64"),
    ],
)  # fmt: skip
def test_what_is_no_bag_of_pictures_is_one_sentence(
    make: Callable[[Path], object], words: str, tmp_path: Path
) -> None:
    """The frames before a bad one are given."""
    seen: list[Frame] = []
    with pytest.raises(UserError, match=words):
        seen.extend(open_source(str(make(tmp_path))).frames())
    assert len(seen) == (2 if make.__name__ == "make" else 0)


def test_compressed_pictures_that_are_none(tmp_path: Path) -> None:
    message = compressed(PICTURES[0].astype(np.uint16), "png", 1.0)
    for name, words in (("deep", "has uint16 values .* --value-range"), ("cut", "is cut off, or")):
        if name == "cut":
            object.__setattr__(message, "data", np.zeros(9, "u1"))
        with pytest.raises(UserError, match=words):
            next(open_source(str(bag(tmp_path / name, image=[(1.0, message)]))).frames())


def test_without_the_extra_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = bag(tmp_path / "bag", image=images())
    monkeypatch.setattr("chromagrip.extras.find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"reading a bag needs the extra `ros`: pip install"):
        open_source(str(folder))
