"""Frames of the sensor at rest: given, the first of the source, or searched for."""

import itertools
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import UserError
from ..render import Frame
from ..sources import NoSourceError, Source, open_source
from ..sources.picture_files import is_pattern, is_picture
from ..stored_pictures import MEGAPIXELS, Image
from ..tracking import detect_markers, join_layers
from .find_sensor import Find


class Resting(NamedTuple):
    """Frames of the sensor at rest, and those to track.

    Attributes
    ----------
    still: of the sensor at rest
    words: which they are
    place: the same for a refusal, with the name of the file
    frames: to track
    """

    still: list[Frame]
    words: str
    place: str
    frames: Iterator[Frame]


def rest_picture(rest: str, source: str) -> Path | None:
    """The rest picture where it lies beside the frames of its folder and is called rest…; or None.

    Recordings and our own datasets keep it there. A picture of another name may be a frame too.
    """
    path, folder = Path(rest), Path(source)
    folder = folder.parent if is_pattern(source) else folder
    if not _called_rest(path):
        return None
    return path if folder.is_dir() and path.parent.samefile(folder) else None


def _called_rest(path: Path) -> bool:
    return path.is_file() and is_picture(path) and path.name.lower().startswith("rest")


def refuse_swapped(rest: str, source: str) -> None:
    """Refuse a folder or a video as the unloaded sensor of a picture that is called rest…."""
    still = Path(rest)
    if _called_rest(Path(source)) and (
        still.is_dir() or (still.is_file() and not is_picture(still))
    ):
        raise UserError(f"rest {rest} and source {source} are swapped: give the rest picture first")


def rest_frames(
    rest: str,
    source: Source,
    find: Find,
    tell: Callable[[str], None],
    fitted: Callable[[Image], Image] = lambda image: image,
    max_megapixels: float = MEGAPIXELS,
) -> Resting:
    """Frames of the sensor at rest, which they are, and the frames to track.

    Parameters
    ----------
    rest: a source of its own, of which the first 8 are taken; `first` or `first:N` of the
        source; or `auto`, the frame of the source whose layers lie most exactly on each other
    source: of the frames to track
    find: palette of a picture's markers
    tell: called with the current step
    fitted: picture as large as the sensor's camera gives it, in which markers are looked for
    max_megapixels: largest picture of a rest frame that is decoded

    Raises
    ------
    UserError
        When there are no such frames.
    """
    if rest == "auto":
        index, frame = _most_exact(source, find, tell, fitted)
        place = f"rest {source.frame_name(index)}"
        return Resting([frame], f"frame {index} of the source, found", place, source.frames())
    first = re.fullmatch(r"first(?::(\d+))?", rest)
    if first is None:
        own = _own_source(rest, max_megapixels)
        if own.live:
            raise UserError(f"rest {rest} is a camera; give a picture, or first:N of the source")
        still = list(itertools.islice(own.frames(), 8))
        words = f"{rest}, mean of {len(still)}" if len(still) > 1 else rest
        if rest_picture(rest, source.name) is not None:
            words += ", not counted as a frame of the source"
        return Resting(still, words, f"rest {rest}", source.frames())
    wanted = int(first[1] or 1)
    if wanted < 1:
        raise UserError(f"rest {rest} is no frame; expected first:1 or more")
    frames = source.frames()
    still = list(itertools.islice(frames, wanted))
    if len(still) < wanted:
        raise UserError(f"rest {rest} needs {wanted} frames; {source.name} has {len(still)}")
    words, place = "first frame of the source", f"rest {source.frame_name(0)}"
    if wanted > 1:
        words = f"first {wanted} frames of the source"
        place = f"rest first {wanted} frames of {source.name}"
    return Resting(still, words, place, itertools.chain(still, frames))


def _own_source(rest: str, max_megapixels: float) -> Source:
    """Source of frames at rest alone."""
    try:
        if not rest.startswith("first:"):
            return open_source(rest, max_megapixels=max_megapixels)
    except NoSourceError:
        pass
    raise UserError(
        f"rest {rest}: there is no such file or folder; give a picture, a folder, a video, first, "
        "first:N or auto"
    )


def _most_exact(
    source: Source, find: Find, tell: Callable[[str], None], fitted: Callable[[Image], Image]
) -> tuple[int, Frame]:
    """Number and frame whose markers of two layers are nearest to each other."""
    if source.live:
        raise UserError("rest auto looks at every frame twice, which is not possible with a camera")
    tried = 200  # frames of the source that the search for the rest frame tries, about
    step = math.ceil((source.count or tried) / tried)
    best: tuple[float, int, Frame] | None = None
    refusal, alone = "there is none", ""
    for index, frame in enumerate(source.frames()):
        tell(f"looking for the rest frame, {index + 1} of {source.count or 'many'}")
        if index % step:
            continue
        try:
            image = fitted(frame.image)
            palette = find(image, frame.image.shape[:2], None)
            if len(palette.names) < 2:
                alone = palette.names[0]
                continue
            layers = detect_markers(image, palette)
        except UserError as error:
            refusal = f"{source.frame_name(index)}: {error}"
            continue
        typical = max(1.0, *(float(np.median(layer.area)) for layer in layers))
        radius = math.sqrt(typical / math.pi)
        first, second = join_layers([layer.position for layer in layers], reach=radius)
        apart = np.linalg.norm(first - second, axis=-1)
        # A marker without a partner counts as one radius apart.
        score = float(np.where(np.isfinite(apart), apart / radius, 1.0).mean())
        if best is None or score < best[0]:
            best = score, index, frame
    if best is None and alone:
        raise UserError(
            f"rest auto needs two layers to compare; {source.name} shows {alone} alone: give a "
            "picture of the unloaded sensor, or first"
        )
    if best is None:
        raise UserError(f"rest auto can use no frame of {source.name}; the last reason: {refusal}")
    return best[1:]
