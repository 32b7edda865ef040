"""Frames from pictures: a file, a folder of them, or a pattern of files."""

import re
from collections import Counter
from collections.abc import Iterator
from glob import glob
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..render import Frame
from ..stored_pictures import MEGAPIXELS, Image, decoded, page_count, pages, unread_kind
from ..strange_files import need_file
from .frame_list import FRAME_LIST, times_of
from .source import SUFFIXES, Source, ValueRange, rated

PNG_BEGIN = b"\x89PNG"
PNG_END = b"IEND\xaeB`\x82"


def is_picture(path: Path) -> bool:
    """Whether a file is named like a picture."""
    return path.suffix.lower() in SUFFIXES


def is_pattern(name: str) -> bool:
    """Whether a name is a pattern of files, such as `shots/*.png`, and not that of a file."""
    return not {"*", "?", "["}.isdisjoint(name) and not Path(name).exists()


def picture_source(
    name: str,
    fps: float | None,
    without: Path | None,
    max_megapixels: float,
    value_range: ValueRange = None,
) -> Source:
    """Source of the pictures in a file, of those in a folder, or of those that match a pattern.

    A folder may have a list `frames.csv` with the time of each picture.

    Parameters
    ----------
    name: that the user gave
    fps: rate (default 30), instead of the times of a list [Hz]
    without: picture that is no frame
    max_megapixels: largest picture that is decoded
    value_range: see `as_levels`

    Raises
    ------
    UserError
        When there are no pictures, or their list cannot be used.
    """
    path = Path(name)
    files, there = _files(name, without)
    if there == [path] and (count := page_count(_content(path))) > 1:
        return _paged_source(path, count, fps, max_megapixels, value_range)
    listed: dict[Path, float] = {}
    if fps is None and path.is_dir() and (path / FRAME_LIST).is_file():
        listed = times_of(path / FRAME_LIST, files, there)
    times = list(listed.values())
    numbers = _periods(files)
    own = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0
    rate, rate_from = rated(fps, own, f"the times in {FRAME_LIST}")
    timed = listed or {path: k / rate for path, k in zip(files, numbers, strict=True)}

    def frames() -> Iterator[Frame]:
        for path, time in timed.items():
            yield Frame(image=read_picture(path, max_megapixels, value_range), time=time)

    return Source(
        name=name,
        frames=frames,
        count=len(files),
        fps=rate,
        fps_from=rate_from,
        timed=bool(listed) or numbers[-1] >= len(files),
        lossy=any(map(_lossy, files)),
        files=tuple(timed),
    )


def _files(name: str, without: Path | None) -> tuple[list[Path], list[Path]]:
    """Pictures that a name stands for, in order, and all files among which they were found."""
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
        others = sorted({kind for p in there if p.is_file() and (kind := unread_kind(p))})
        but = f" but {', '.join(others)}, which is not read" if others else ""
        if inner := next((p for p in sorted(there) if _has_pictures(p)), None):
            raise UserError(f"{place} has no pictures, but its folder {inner.name} has: give that")
        raise UserError(f"{place} has no pictures{but}; expected {', '.join(SUFFIXES)} files")
    if there != [path]:
        files = [p for p in files if without is None or not p.samefile(without)]
        files = [p for p in files if p.stem.lower() != "rest"] or files
    if not files:
        raise UserError(f"{place} has no pictures but {without}")
    times = Counter(p.stem for p in files)
    twice = next((p for p in sorted(files, key=_natural) if times[p.stem] > 1), None)
    if path.is_dir() and twice is not None:
        raise UserError(
            f"{place} has {twice.stem} as pictures of two kinds; give one of them, such as "
            f"'{path}/*{twice.suffix}'"
        )
    files = sorted(files, key=_natural)
    if path.is_dir() and not (path / FRAME_LIST).is_file():
        _refuse_two_series(files, path)
    return files, there


def _series(files: list[Path]) -> dict[str, list[int]]:
    """Numbers of pictures by the rest of their names, with * in the place of the number.

    Of several numbers in a name the one that differs most counts.
    """
    forms: dict[str, list[list[str]]] = {}
    for path in files:
        parts = re.split(r"(\d+)", path.stem)
        forms.setdefault("*".join(parts[::2]), []).append(parts)
    series: dict[str, list[int]] = {}
    for names in forms.values():
        columns = range(1, len(names[0]), 2)
        column = max(columns, key=lambda k: (len({parts[k] for parts in names}), k), default=0)
        for parts in names:
            number = int(parts[column]) if column else 0
            form = [*parts[:column], "*", *parts[column + 1 :]] if column else parts
            series.setdefault("".join(form), []).append(number)
    return series


def _refuse_two_series(files: list[Path], folder: Path) -> None:
    """Refuse other pictures beside a series, and two of them: one would follow the other."""
    series = {form: set(numbers) for form, numbers in _series(files).items()}
    one = max(series, key=lambda form: len(series[form]), default="")
    if len(series.get(one, ())) < 4:
        return  # pictures with names of their own
    for other in series.keys() - {one}:
        named = re.sub(r"\d+", "", one) != re.sub(r"\d+", "", other)
        # One number may be that of a camera; several are often a time.
        counted = series[one] == series[other] and len(re.findall(r"\d+", one)) == 1
        if named or counted:
            pattern = one.replace("*", "[0-9]*")
            raise UserError(
                f"folder {folder} has {other} beside {one}; give one of them as "
                f"'{folder}/{pattern}.*', or all as '{folder}/*'"
            )


def _periods(files: list[Path]) -> list[int]:
    """Number of periods from the first to each of n files, of which some may be missing, (n,)."""
    numbers = list(_series(files).values())
    if len(numbers) == 1 and len(numbers[0]) == len(files) > 3:
        steps = [after - before for before, after in pairwise(numbers[0])]
        step, times = Counter(steps).most_common(1)[0]
        if step > 0 and 2 * times >= len(steps) and all(k > 0 and k % step == 0 for k in steps):
            return [(number - numbers[0][0]) // step for number in numbers[0]]
    return list(range(len(files)))


def _has_pictures(path: Path) -> bool:
    return any(map(is_picture, path.glob("*")))  # none where it cannot be read


def _lossy(path: Path) -> bool:
    """Whether the compression of a picture leaves errors, by its name; a WebP may have none."""
    suffix = path.suffix.lower()
    return suffix in (".jpg", ".jpeg") or (
        suffix == ".webp" and b"VP8L" not in _content(path)[:200]
    )


def _paged_source(
    path: Path, count: int, fps: float | None, max_megapixels: float, value_range: ValueRange
) -> Source:
    """Source of the pages of a TIFF, or of an animation, which has times of its own."""
    name = f"picture {path}"
    first = next(pages(_content(path), name, max_megapixels)).seconds
    rate, rate_from = rated(fps, 1.0 / first if first > 0.0 else 0.0, "the file's own")
    timed = fps is None and first > 0.0

    def frames() -> Iterator[Frame]:
        time = 0.0
        for index, page in enumerate(pages(_content(path), name, max_megapixels)):
            if page.pixels is None:
                raise UserError(f"{name} breaks off after {index} of {count} pictures")
            image = _picture(page.pixels, f"{name}, page {index}", value_range)
            yield Frame(image=image, time=time if timed else index / rate)
            time += page.seconds

    return Source(
        name=str(path),
        frames=frames,
        count=count,
        fps=rate,
        fps_from=rate_from,
        timed=timed,
        lossy=_lossy(path),
        files=(path,),
    )


def _refuse_home(folder: Path) -> None:
    """Refuse a run and a dataset, whose pictures of frames lie further down."""
    if (folder / "summary.json").is_file() and any(folder.glob("trace.*")):
        kept = folder / "frames"
        frames = kept if kept.is_dir() else folder / "tactile.mp4"
        raise UserError(f"folder {folder} is a run, whose frames are in {frames}: give that")
    if (folder / "manifest.json").is_file() and any(folder.glob("sequence-*")):
        one = min(folder.glob("sequence-*"))
        raise UserError(f"folder {folder} is a dataset: give one of its sequences, such as {one}")


def read_picture(
    path: Path, max_megapixels: float = MEGAPIXELS, value_range: ValueRange = None
) -> Image:
    """Picture of a file, sRGB, shape (H, W, 3); a grey one has three equal channels.

    It is turned as viewers show it. A larger one than `max_megapixels` is not decoded.

    Raises
    ------
    UserError
        When the file is no complete picture, holds several, is too large, is transparent, or has
        more than 8 bits a channel without a `value_range`.
    """
    name, data = f"picture {path}", _content(path)
    if (count := page_count(data)) > 1:
        raise UserError(
            f"{name} holds {count} pictures; wanted here: one (as a source of `chromagrip track` "
            "such a file stands alone)"
        )
    return decoded_picture(data, name, path.suffix.lower()[1:], max_megapixels, value_range)


def _content(path: Path) -> bytes:
    """Content of the file of a picture."""
    need_file(path, f"picture {path}")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"picture {path} cannot be read: {error.strerror}") from None
    if not data:
        raise UserError(f"picture {path} is empty (0 bytes)")
    return data


def decoded_picture(
    data: bytes, name: str, kind: str, max_megapixels: float, value_range: ValueRange = None
) -> Image:
    """Picture of the bytes of a file; `name` and `kind` are for messages, see `read_picture`."""
    pixels = decoded(data, name, max_megapixels)
    if pixels is None:
        other = unread_kind(Path(name), data)
        why = f"{other}, which is not read" if other else f"cut off, or not a {kind} file"
        raise UserError(f"{name} cannot be read: it is {why}")
    return _picture(pixels, name, value_range)


def _picture(pixels: NDArray[Any], name: str, value_range: ValueRange) -> Image:
    """Opaque picture of 8 bits and three channels."""
    if pixels.ndim == 3 and pixels.shape[2] == 4:
        opaque = np.iinfo(pixels.dtype).max if pixels.dtype.kind in "iu" else 1.0
        if (pixels[..., 3] < opaque).any():
            raise UserError(f"{name} has transparent pixels; wanted: an opaque picture")
        pixels = pixels[..., :3]
    image = as_levels(pixels, name, value_range)
    if image.ndim == 2:
        return np.repeat(image[..., None], 3, axis=2)
    return np.ascontiguousarray(image)


def as_levels(values: NDArray[Any], name: str, value_range: ValueRange) -> Image:
    """Grey levels 0 to 255 of the values of a picture.

    Parameters
    ----------
    values: any shape; those of 8 bits are grey levels
    name: of the picture, for messages
    value_range: values of black and white; those beyond become black or white

    Raises
    ------
    UserError
        When values have more than 8 bits, and the range is not given or they are not finite.
    """
    if values.dtype == np.uint8:
        return values
    if not np.isfinite(values).all():
        raise UserError(f"{name} has {values.dtype} values that are not numbers")
    if value_range is None:
        raise UserError(
            f"{name} has {values.dtype} values from {values.min():g} to {values.max():g}; what is "
            "black and white in them must be given: detect, track and estimate take --value-range "
            "BLACK,WHITE (value_range in Python)"
        )
    black, white = value_range
    levels = np.float32(255.0 / (white - black)) * (values.astype(np.float32) - np.float32(black))
    return np.rint(np.clip(levels, 0.0, 255.0)).astype(np.uint8)


def _natural(path: Path) -> list[tuple[int, str]]:
    """Key that sorts frame-2 before frame-10."""
    parts = re.findall(r"\d+|\D+", str(path))
    return [(int(p), "") if p.isdecimal() else (-1, p.lower()) for p in parts]
