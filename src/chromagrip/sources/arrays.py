"""Frames of NumPy's files: one array of pictures, in an archive with their times."""

import math
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..render import Frame
from ..stored_pictures import check_pixels
from ..strange_files import array_headers, array_names, read_arrays, read_header
from .picture_files import as_levels
from .source import Source, ValueRange, rated

_PICTURES = ("images", "frames")
_TIMES = ("times", "time_s")
_WANTED = (
    "wanted: an array uint8, or of other numbers with --value-range BLACK,WHITE, (N, H, W, 3) or "
    "(N, H, W), in an archive called images or frames, there perhaps with times or time_s (N,) [s]"
)


def array_source(
    path: Path, fps: float | None, max_megapixels: float, value_range: ValueRange
) -> Source:
    """Source of a `.npy` or a `.npz` file; `fps` [Hz] overrides the times of the second.

    `value_range` has black and white of values that are not uint8, see `as_levels`.

    Raises
    ------
    UserError
        When the file does not hold pictures, or larger ones.
    """
    name, times = "", None
    if path.suffix.lower() == ".npz":
        there = array_names(path)
        name = next((each for each in _PICTURES if each in there), "")
        if not name:
            raise UserError(f"{path} has {', '.join(there) or 'no array'}; {_WANTED}")
        array_headers(path, [name])  # refuses one that claims more than is stored
        for key in [each for each in _TIMES if each in there][:1]:
            times = read_arrays(path, [key])[key]
    with _opened(path, name) as (_, shape, kind):
        if kind != np.uint8 and value_range is None:
            raise UserError(f"{path} has {kind} {shape}; {_WANTED}")
    check_pixels(shape[2], shape[1], f"array {path}", max_megapixels)
    if times is not None:
        numbers = times.shape == shape[:1] and times.dtype.kind in "fiu"
        if not (numbers and np.isfinite(times).all()):
            raise UserError(f"{path} has times {times.dtype} {times.shape}; {_WANTED}")
    if fps is not None:
        times = None
    span = 0.0 if times is None or not len(times) else float(times[-1] - times[0])
    own = (shape[0] - 1) / span if span > 0.0 else 0.0
    rate, rate_from = rated(fps, own, "the file's own")
    return Source(
        name=str(path),
        frames=lambda: _frames(path, name, times, rate, value_range),
        count=shape[0],
        fps=rate,
        fps_from=rate_from,
        timed=times is not None,
    )


@contextmanager
def _opened(path: Path, name: str) -> Iterator[tuple[BinaryIO, tuple[int, ...], np.dtype[Any]]]:
    """Open the file of an array, or an archive at an array; also gives its shape and type."""
    try:
        with ExitStack() as files:
            file: Any = files.enter_context(path.open("rb"))
            if name:
                archive = files.enter_context(zipfile.ZipFile(file))
                file = files.enter_context(archive.open(f"{name}.npy"))
            shape, turned, kind = read_header(file)
            pictures = len(shape) == 3 or (len(shape) == 4 and shape[3] == 3)
            if kind.kind not in "uif" or not pictures or turned or 0 in shape[1:]:
                order = ", columns first" if turned else ""
                raise UserError(f"{path} has {kind} {shape}{order}; {_WANTED}")
            yield file, shape, kind
    except UserError:
        raise
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"{path} cannot be read: {reason}; {_WANTED}") from None


def _frames(
    path: Path, name: str, times: NDArray[Any] | None, rate: float, value_range: ValueRange
) -> Iterator[Frame]:
    """Read picture after picture: a whole file may be larger than the memory."""
    with _opened(path, name) as (file, shape, kind):
        size = math.prod(shape[1:]) * kind.itemsize
        for index in range(shape[0]):
            data = file.read(size)
            if len(data) < size:
                raise UserError(f"{path} breaks off after {index} of {shape[0]} frames")
            values = np.frombuffer(data, kind).reshape(shape[1:])
            image = as_levels(values, f"array {path}", value_range)
            image = np.array(image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2))
            time = index / rate if times is None else float(times[index])
            yield Frame(image=image, time=time)
