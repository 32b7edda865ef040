"""Frames from pictures: a file, a folder of them, or a pattern of files."""

import re
from collections.abc import Iterator
from glob import glob
from pathlib import Path

import numpy as np

from ..errors import UserError
from ..render import Frame
from ..stored_pictures import MEGAPIXELS, Image, decoded
from .frame_list import FRAME_LIST, times_of
from .source import SUFFIXES, Source, rated

_LOSSY = (".jpg", ".jpeg")
PNG_BEGIN = b"\x89PNG"
PNG_END = b"IEND\xaeB`\x82"


def is_picture(path: Path) -> bool:
    """Whether a file is named like a picture."""
    return path.suffix.lower() in SUFFIXES


def is_pattern(name: str) -> bool:
    """Whether a name is a pattern of files, such as `shots/*.png`, and not that of a file."""
    return not {"*", "?", "["}.isdisjoint(name) and not Path(name).exists()


def picture_source(
    name: str, fps: float | None, without: Path | None, max_megapixels: float
) -> Source:
    """Source of a picture, of those in a folder, or of those that match a pattern.

    A folder may have a list `frames.csv` with the time of each picture.

    Parameters
    ----------
    name: that the user gave
    fps: rate (default 30), instead of the times of a list [Hz]
    without: picture that is no frame
    max_megapixels: largest picture that is decoded

    Raises
    ------
    UserError
        When there are no pictures, or their list cannot be used.
    """
    path, place = Path(name), f"folder {name}"
    if path.is_dir():
        _refuse_home(path)
        there = list(path.iterdir())
    elif is_pattern(name):
        place, there = f"pattern {name}", [Path(each) for each in glob(name, recursive=True)]
    else:
        there = [path]
    files = [p for p in there if is_picture(p) and not p.name.startswith(".")]
    if not files:
        raise UserError(f"{place} has no pictures; expected {', '.join(SUFFIXES)} files")
    if there != [path]:
        files = [p for p in files if without is None or not p.samefile(without)]
        files = [p for p in files if p.stem.lower() != "rest"] or files
    if not files:
        raise UserError(f"{place} has no pictures but {without}")
    files.sort(key=_natural)
    listed: dict[Path, float] = {}
    if fps is None and path.is_dir() and (path / FRAME_LIST).is_file():
        listed = times_of(path / FRAME_LIST, files, there)
    times = list(listed.values())
    own = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0
    rate, rate_from = rated(fps, own, f"the times in {FRAME_LIST}")
    timed = listed or {path: k / rate for k, path in enumerate(files)}

    def frames() -> Iterator[Frame]:
        for path, time in timed.items():
            yield Frame(image=read_picture(path, max_megapixels), time=time)

    return Source(
        name=name,
        frames=frames,
        count=len(files),
        fps=rate,
        fps_from=rate_from,
        timed=bool(listed),
        lossy=any(path.suffix.lower() in _LOSSY for path in files),
        files=tuple(timed),
    )


def _refuse_home(folder: Path) -> None:
    """Refuse a run and a dataset, whose pictures of frames lie further down."""
    traces = (folder / f"trace{suffix}" for suffix in (".parquet", ".npz"))
    if (folder / "summary.json").is_file() and any(trace.is_file() for trace in traces):
        kept = folder / "frames"
        frames = kept if kept.is_dir() else folder / "tactile.mp4"
        raise UserError(f"folder {folder} is a run, whose frames are in {frames}: give that")
    if (folder / "manifest.json").is_file() and any(folder.glob("sequence-*")):
        one = min(folder.glob("sequence-*"))
        raise UserError(f"folder {folder} is a dataset: give one of its sequences, such as {one}")
    if (folder / "noise.json").is_file() and (folder / "clean.png").is_file():
        raise UserError(
            f"folder {folder} keeps its pictures without noise (store clean): make the dataset "
            "with --store noisy, or take the pictures of `chromagrip dataset export`"
        )


def read_picture(path: Path, max_megapixels: float = MEGAPIXELS) -> Image:
    """Picture of a file, sRGB, shape (H, W, 3); a grey one has three equal channels.

    It is as it was stored, not turned by the file's metadata. A larger one than `max_megapixels`
    is not decoded.

    Raises
    ------
    UserError
        When the file is no complete picture, is too large, has more than 8 bits a channel, or is
        transparent.
    """
    name = f"picture {path}"
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{name} cannot be read: {error.strerror}") from None
    if not data:
        raise UserError(f"{name} is empty (0 bytes)")
    kind = path.suffix.lower().removeprefix(".")
    return decoded_picture(data, name, kind, max_megapixels)


def decoded_picture(data: bytes, name: str, kind: str, max_megapixels: float) -> Image:
    """Picture of the bytes of a file; `name` and `kind` are for messages, see `read_picture`."""
    image = decoded(data, name, max_megapixels)
    if image is None:
        raise UserError(f"{name} cannot be read: it is cut off, or not a {kind} file")
    if isinstance(image, str):
        raise UserError(
            f"{name} has {image} values; wanted: 8 bits a channel, because the range of wider "
            "values is not known"
        )
    if image.ndim == 3 and image.shape[2] == 4 and (image[..., 3] < 255).any():
        raise UserError(f"{name} has transparent pixels; wanted: an opaque picture")
    if image.ndim == 2:
        return np.repeat(image[..., None], 3, axis=2)
    return np.ascontiguousarray(image[..., :3])


def _natural(path: Path) -> list[tuple[int, str]]:
    """Key that sorts frame-2 before frame-10."""
    parts = re.findall(r"\d+|\D+", str(path))
    return [(int(p), "") if p.isdecimal() else (-1, p.lower()) for p in parts]
