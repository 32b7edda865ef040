"""Frames of the sensor at rest: given, the first of the source, or searched for."""

import itertools
import math
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, TypedDict

import numpy as np

from ..errors import UserError
from ..render import Frame
from ..sources import NoSourceError, Source, open_source
from ..sources.picture_files import is_pattern, is_picture
from ..sources.source import ValueRange
from ..stored_pictures import MEGAPIXELS, Image
from ..tracking import detect_markers, join_layers
from .find_sensor import Find
from .good_rest import unlike
from .scale import Scale


class LeftOut(TypedDict):
    """A rest frame that is not used: its number, what it is called, and what is wrong with it."""

    frame: int
    name: str
    because: str


class Resting(NamedTuple):
    """Frames of the sensor at rest, and those to track.

    Attributes
    ----------
    still: of the sensor at rest, of one size
    words: which they are
    place: the same for a refusal, with the name of the file
    frames: to track
    name: what a rest frame of that number is called
    left_out: those that are unlike the others, which `still` does not have
    """

    still: list[Frame]
    words: str
    place: str
    frames: Iterator[Frame]
    name: Callable[[int], str]
    left_out: tuple[LeftOut, ...] = ()


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
    scale_of: Callable[[Image], Scale],
    max_megapixels: float = MEGAPIXELS,
    value_range: ValueRange = None,
) -> Resting:
    """Frames of the sensor at rest, which they are, and the frames to track.

    Those that are unlike most others are left out, see `unlike`.

    Parameters
    ----------
    rest: a source of its own, of which the first 8 are taken; `first` or `first:N` of the
        source; or `auto`, the frame of the source whose layers lie most exactly on each other
    source: of the frames to track
    find: palette of a picture's markers
    tell: called with the current step
    scale_of: scale to the pictures in which markers are looked for
    max_megapixels: largest picture of a rest frame that is decoded
    value_range: see `open_source`

    Raises
    ------
    UserError
        When there are no such frames, or fewer than half of them are alike.
    """
    found = _given_frames(rest, source, find, tell, scale_of, max_megapixels, value_range)
    return _judged(found, find, scale_of)


def _judged(found: Resting, find: Find, scale_of: Callable[[Image], Scale]) -> Resting:
    """Rest frames without those that are unlike the others."""
    images = [frame.image for frame in found.still]
    if not images:
        raise UserError(f"{found.place} has no frames")
    sizes = {f"{image.shape[1]}×{image.shape[0]}" for image in images}
    if len(sizes) > 1:
        words = ", ".join(sorted(sizes))
        raise UserError(f"{found.place}: the rest frames have different sizes: {words} pixels")
    wrong = unlike(images)
    if not wrong:
        return found
    with suppress(UserError):  # what moves beside the sensor does not count, if it can be found
        mean = np.mean(images, axis=0).astype(np.uint8)
        seen = find(scale_of(mean)(mean), mean.shape[:2]).seen
        wrong = unlike(images, None if seen is None else seen.field)
    left_out = tuple(
        LeftOut(frame=k, name=found.name(k), because=word) for k, word in wrong.items()
    )
    if 2 * len(left_out) > len(images):
        some = "; ".join(f"frame {each['frame']} is {each['because']}" for each in left_out[:3])
        raise UserError(
            f"{found.place}: only {len(images) - len(left_out)} of {len(images)} rest frames are "
            f"alike, wanted: half of them or more; {some}"
        )
    still = [frame for k, frame in enumerate(found.still) if k not in wrong]
    words = f"{found.words}, {len(left_out)} of them left out" if left_out else found.words
    return found._replace(still=still, words=words, left_out=left_out)


def _given_frames(
    rest: str,
    source: Source,
    find: Find,
    tell: Callable[[str], None],
    scale_of: Callable[[Image], Scale],
    max_megapixels: float,
    value_range: ValueRange,
) -> Resting:
    """Frames at rest as they were given; see `rest_frames`."""
    if rest == "auto":
        index, frame = _most_exact(source, find, tell, scale_of)
        place = f"rest {source.frame_name(index)}"
        words = f"frame {index} of the source, found"
        return Resting([frame], words, place, source.frames(), source.frame_name)
    first = re.fullmatch(r"first(?::(\d+))?", rest)
    if first is None:
        own = _own_source(rest, max_megapixels, value_range)
        if own.live:
            raise UserError(f"rest {rest} is a camera; give a picture, or first:N of the source")
        still = list(itertools.islice(own.frames(), 8))
        words = f"{rest}, mean of {len(still)}" if len(still) > 1 else rest
        if rest_picture(rest, source.name) is not None:
            words += ", not counted as a frame of the source"
        return Resting(still, words, f"rest {rest}", source.frames(), own.frame_name)
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
    return Resting(still, words, place, itertools.chain(still, frames), source.frame_name)


def _own_source(rest: str, max_megapixels: float, value_range: ValueRange) -> Source:
    """Source of frames at rest alone."""
    try:
        if not rest.startswith("first:"):
            return open_source(rest, max_megapixels=max_megapixels, value_range=value_range)
    except NoSourceError:
        pass
    raise UserError(
        f"rest {rest}: there is no such file or folder; give a picture, a folder, a video, first, "
        "first:N or auto"
    )


def _most_exact(
    source: Source, find: Find, tell: Callable[[str], None], scale_of: Callable[[Image], Scale]
) -> tuple[int, Frame]:
    """Number and frame whose markers of two layers are nearest to each other."""
    if source.live:
        raise UserError("rest auto looks at every frame twice, which is not possible with a camera")
    tried = 200  # frames of the source that the search for the rest frame tries, about
    step = math.ceil((source.count or tried) / tried)
    best: tuple[float, int, Frame] | None = None
    scale, refusal, alone = None, "there is none", ""
    for index, frame in enumerate(source.frames()):
        tell(f"looking for the rest frame, {index + 1} of {source.count or 'many'}")
        if index % step:
            continue
        try:
            scale = scale or scale_of(frame.image)
            image = scale(frame.image)
            palette = find(image, frame.image.shape[:2])
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
