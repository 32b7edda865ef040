"""Frames that another program writes into a pipe or a file."""

import io
import math
from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..arguments import arguments_in
from ..errors import UserError
from ..render import Frame
from ..stored_pictures import check_pixels
from ..strange_files import read_header
from .source import Source, rated


def pipe_source(name: str, fps: float | None, max_megapixels: float) -> Source:
    """Source of `pipe:FILE`; its times are its own, and `fps` is nominal [Hz].

    With `pipe:FILE(live=true)` the program writes in real time, and a slower loop skips frames.
    """
    rate, rate_from = rated(fps)
    place, bracket, rest = name.removeprefix("pipe:").partition("(")
    given = arguments_in(rest[:-1], name) if bracket and rest.endswith(")") else {}
    if bracket and given not in ({"live": True}, {"live": False}):
        raise UserError(f"{name}: expected pipe:FILE or pipe:FILE(live=true)")
    return Source(
        name=name,
        frames=lambda: _frames(place, max_megapixels),
        live=bool(given.get("live")),
        count=None,
        fps=rate,
        fps_from=rate_from,
        timed=True,
    )


def pipe_bytes(frame: Frame) -> bytes:
    """Bytes that a program writes for a frame into a pipe, which is read as `pipe:FILE`."""
    data = io.BytesIO()  # NumPy cannot write into a pipe
    np.save(data, np.float64(frame.time))
    np.save(data, frame.image)
    return data.getvalue()


def _frames(name: str, max_megapixels: float) -> Iterator[Frame]:
    """Frames that another program writes: time [s] and picture of each, as NumPy's .npy files.

    A `-` is the standard input.
    """
    count = 0
    try:
        with open(0 if name == "-" else name, "rb", closefd=name != "-") as file:
            while file.peek(1):
                try:
                    time, image = (_piped(file, name, max_megapixels) for _ in range(2))
                except UserError:
                    raise
                except (ValueError, EOFError) as error:
                    raise UserError(
                        f"pipe:{name} breaks off after {count} frames: {error}"
                    ) from None
                if time.ndim or image.dtype != np.uint8 or image.shape[2:] != (3,):
                    raise UserError(
                        f"pipe:{name} gave {time.dtype} {time.shape} and {image.dtype} "
                        f"{image.shape}; wanted: a time, then a picture uint8 (H, W, 3)"
                    )
                count += 1
                yield Frame(image=image, time=float(time))
    except OSError as error:
        raise UserError(f"pipe:{name} cannot be read: {error.strerror}") from None


def _piped(file: BinaryIO, name: str, max_megapixels: float) -> NDArray[Any]:
    """Array of a pipe; NumPy would ask a file for its place, which a pipe does not have."""
    shape, turned, kind = read_header(file)
    height, width = (*shape, 1, 1)[:2]
    check_pixels(width, height, f"pipe:{name}", max_megapixels)
    size = math.prod(shape) * kind.itemsize
    if kind.hasobject or size > 3e6 * max_megapixels:
        raise ValueError(f"{kind} {shape} is no picture")
    data = file.read(size)
    if len(data) < size:
        raise EOFError(f"{len(data)} of {size} bytes")
    return np.frombuffer(data, kind).reshape(shape, order="F" if turned else "C").copy()
