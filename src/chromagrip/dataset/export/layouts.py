"""Export a dataset in the layouts of other tools: TAP-Vid, COCO, WebDataset, LeRobot."""

import io
import json
import pickle
import tarfile
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, count, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError
from ...render import LAYERS
from ..folder import Place, link
from ..read import Loaded, check_shared, read_split, verified
from ..remote import fetched, staged
from .lerobot import write_lerobot

#: Function called with the number of sequences done.
Progress = Callable[[int], None]


def export(
    folder: Place,
    layout: str,
    out: Place,
    progress: Progress = lambda done: None,
    *,
    follow_links: bool = False,
) -> list[Path]:
    """Write a dataset in another layout; returns its files.

    The files of every sequence are verified before they are read. The parts of a split dataset get
    a folder each; LeRobot lists them as its splits.

    Parameters
    ----------
    folder: folder of the dataset, or its address
    layout: name in LAYOUTS, or lerobot
    out: folder, new or empty; it is removed if the export fails
    progress: function called after each sequence with the number of sequences done
    follow_links: whether links in the folder may lead out of it, as in caches of hubs

    Raises
    ------
    UserError
        When the dataset is not complete or has changed, does not fit the layout, or cannot be
        written.
    """
    folder = fetched(folder, follow_links)
    digests, parts = check_shared(folder)["sequences"], read_split(folder)
    done = count(1)

    def counted(names: Iterable[str]) -> Iterator[Loaded]:
        for one in verified(folder, names):
            yield one
            progress(next(done))

    with staged(out) as whole:
        if layout == "lerobot":
            names = [name for part in parts.values() for name in part] or list(digests)
            sizes = {part: len(own) for part, own in parts.items()}
            write_lerobot(counted(names), whole, sizes or {"train": len(names)})
        elif parts:
            for part, own in parts.items():
                (whole / part).mkdir()
                LAYOUTS[layout](counted(own), whole / part)
        else:
            LAYOUTS[layout](counted(digests), whole)
        files = [file.relative_to(whole) for file in whole.rglob("*") if file.is_file()]
    return sorted(Path(out) / file for file in files)


def _write_tapvid(sequences: Iterator[Loaded], out: Path) -> None:
    """Pickles of name → video (T, H, W, 3), points (P, T, 2) from 0 to 1, occluded (P, T).

    Points are measured from the corner of the first pixel, magenta markers before yellow ones. The
    first frame shows the sensor at rest.
    """
    batch: dict[str, dict[str, NDArray[Any]]] = {}
    numbers = count()

    def flush() -> None:
        if batch:
            name = f"tapvid-{next(numbers):05d}.pkl"
            with (out / name).open("wb") as file:
                pickle.dump(batch, file, protocol=4)
            batch.clear()

    pickled = 10  # number of sequences in a pickle: its reader holds all in memory
    for one in sequences:
        video = np.stack(list(one.images()))
        height, width = video.shape[1:3]
        points = (one.places.reshape(len(video), -1, 2) + 0.5) / [width, height]
        visible = one.visible.reshape(len(video), -1)
        ever = visible.any(axis=0)
        points = np.where(np.isfinite(points), points, 0.0)
        batch[f"sequence-{one.number:06d}"] = {
            "video": video,
            "points": np.swapaxes(points, 0, 1)[ever].astype(np.float32),
            "occluded": ~visible.T[ever],
        }
        if len(batch) == pickled:
            flush()
    flush()


def _write_coco(sequences: Iterator[Loaded], out: Path) -> None:
    """COCO keypoints: `annotations.json`, one fingertip a picture, and `images`."""
    (out / "images").mkdir()
    images: list[dict[str, object]] = []
    names: list[str] = []
    # Written one by one: all pictures with 800 keypoints each would fill the memory.
    with (out / "annotations.json").open("w", encoding="utf-8") as file:
        file.write('{"annotations": [')
        for one in sequences:
            view = one.scene.build_sensor().view
            own = [f"{layer}-{m:03d}" for layer in LAYERS for m in range(one.places.shape[2])]
            if names and own != names:
                raise UserError(
                    f"sequence {one.number} has {len(own)} markers, others {len(names)}; COCO "
                    "needs one list of keypoints for all"
                )
            names = own
            for t in range(len(one.pictures)):
                name = f"sequence-{one.number:06d}-frame-{t:03d}.png"
                _ = one.pictures[t]  # it may be damaged
                link(one.pictures.files[t], out / "images" / name)
                number = len(images) + 1
                images.append(
                    {"id": number, "file_name": name, "width": view.width, "height": view.height}
                )
                file.write(",\n" if number > 1 else "\n")
                file.write(json.dumps(_annotation(one, t, number)))
        category = {
            "id": 1,
            "name": "fingertip",
            "supercategory": "sensor",
            "keypoints": names,
            "skeleton": [],
        }
        rest = json.dumps({"images": images, "categories": [category]})
        file.write(f"],\n{rest[1:]}")


def _annotation(one: Loaded, t: int, number: int) -> dict[str, object]:
    """Keypoints (x, y, v) of a frame; v is 2 for a visible marker, else 0."""
    places, visible = one.places[t].reshape(-1, 2), one.visible[t].ravel()
    keypoints = np.zeros((len(places), 3))
    keypoints[visible] = np.column_stack([np.round(places[visible], 3), np.full(visible.sum(), 2)])
    own = places[visible] if visible.any() else np.zeros((1, 2))
    low, high = own.min(axis=0), own.max(axis=0)
    x, y, w, h = (round(float(v), 3) for v in (*(low + 0.5), *(high - low)))
    return {
        "id": number,
        "image_id": number,
        "category_id": 1,
        "keypoints": [int(v) if v == int(v) else v for v in keypoints.ravel().tolist()],
        "num_keypoints": int(visible.sum()),
        "bbox": [x, y, w, h],
        "area": round(w * h, 3),
        "iscrowd": 0,
    }


def _write_webdataset(sequences: Iterator[Loaded], out: Path) -> None:
    """Tar files of frames: KEY.png, KEY.json (values of frame and sequence), KEY.npz (markers)."""
    frames = _frames(sequences)
    tarred = 1000  # number of frames in a tar file
    for number in count():
        first = next(frames, None)
        if first is None:
            return
        with tarfile.open(out / f"frames-{number:06d}.tar", "w") as tar:
            for files in chain([first], islice(frames, tarred - 1)):
                for name, data in files.items():
                    _add(tar, name, data)


def _frames(sequences: Iterator[Loaded]) -> Iterator[dict[str, bytes]]:
    """Files of each frame, by name."""
    for one in sequences:
        for t in range(len(one.pictures)):
            key = f"{one.number:06d}-{t:03d}"
            values = {name: _plain(column[t]) for name, column in one.frames.items()}
            text = json.dumps({"sequence": one.number, **values, "drawn": one.values})
            arrays = {name: column[t] for name, column in one.markers.items()}
            _ = one.pictures[t]  # it may be damaged
            buffer = io.BytesIO()
            np.savez(buffer, **arrays)
            yield {
                f"{key}.png": one.pictures.files[t].read_bytes(),
                f"{key}.json": text.encode(),
                f"{key}.npz": buffer.getvalue(),
            }


def _add(tar: tarfile.TarFile, name: str, data: bytes) -> None:
    """Add a file without time or owner."""
    entry = tarfile.TarInfo(name)
    entry.size = len(data)
    tar.addfile(entry, io.BytesIO(data))


def _plain(value: Any) -> Any:
    """Value for JSON: NaN and infinity are null."""
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not np.isfinite(value) else value


#: Writers of the layouts whose parts are folders, by name.
LAYOUTS: dict[str, Callable[[Iterator[Loaded], Path], None]] = {
    "tapvid": _write_tapvid,
    "coco": _write_coco,
    "webdataset": _write_webdataset,
}
