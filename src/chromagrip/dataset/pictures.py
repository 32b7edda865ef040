"""Pictures of a sequence as a dataset keeps them: with their noise, or without it.

store = "noisy"   rest.png, frame-000.png, …: pictures of the camera
store = "clean"   clean.png: the unloaded sensor without noise
                  change-000.png, …: pictures without noise less clean.png, modulo 256
                  noise.json: what the noise is made from

Without noise two pictures of a sequence are the same almost everywhere, so that their difference
takes a twentieth of the room. The noise of a frame follows from its level, the seed and the frame's
number; a sum over a sample of it tells whether this version makes the same noise.
"""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any
from zlib import crc32

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from ..errors import UserError
from ..folders import disk_errors
from ..output.png import encode_png
from ..render import add_noise
from ..sensing.camera import REST_NUMBER
from ..sources.picture_files import read_picture
from ..strange_files import read_small
from .recipe import Store

Image = NDArray[np.uint8]
#: Names of the pictures of the unloaded sensor, and what the noise of a sequence is made from.
REST = "rest.png"
CLEAN = "clean.png"
NOISE = "noise.json"
#: Starts of the names of the frames' pictures, by how they are kept.
FRAME: dict[Store, str] = {"noisy": "frame", "clean": "change"}


class NoiseKey(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings from which the noise of a sequence's pictures is made; content of `noise.json`.

    Attributes
    ----------
    sigma, seed: arguments of `add_noise`; its index is the number of the frame
    rest: index of the picture of the unloaded sensor
    sample: checksum of some of this noise
    """

    sigma: Annotated[float, Meta(ge=0.0, le=50.0)]
    seed: Annotated[int, Meta(ge=0, lt=2**32)]
    rest: Annotated[int, Meta(ge=0, lt=2**32)]
    sample: Annotated[int, Meta(ge=0, lt=2**32)]


def noise_key(sigma: float, seed: int) -> NoiseKey:
    """Key of the noise of that level and seed, as this version makes it."""
    grey = np.full((40, 40, 3), 128, np.uint8)
    add_noise(grey, sigma, seed, REST_NUMBER)
    return NoiseKey(sigma=sigma, seed=seed, rest=REST_NUMBER, sample=crc32(grey.tobytes()))


def read_key(folder: Path) -> NoiseKey:
    """Key of the noise of a sequence's folder.

    Raises
    ------
    UserError
        When it cannot be read, or this version makes other noise of it.
    """
    path = folder / NOISE
    try:
        key = msgspec.json.decode(read_small(path), type=NoiseKey)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise UserError(f"{path} is missing or damaged") from None
    if noise_key(key.sigma, key.seed) != key:
        raise UserError(
            f"{path} is of noise that this version of chromagrip does not make; read the dataset "
            "with the version that its manifest.json names"
        )
    return key


def change_png(image: Image, rest: Image) -> bytes:
    """PNG file of a picture without noise: its difference from that of the unloaded sensor."""
    return encode_png(image - rest, runs=True)


@dataclass(frozen=True, kw_only=True)
class Pictures:
    """Pictures of the frames of a sequence, RGB, shape (H, W, 3), read on demand.

    Attributes
    ----------
    folder: folder of the sequence
    files: file of each frame, in order
    store: format of the kept pictures
    size: height and width of each [px]; None if they are unknown
    """

    folder: Path
    files: tuple[Path, ...]
    store: Store
    size: tuple[int, int] | None = None

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.files)

    def __getitem__(self, frame: int) -> Image:
        """Picture of a frame."""
        image = self._sized(self.files[frame], read_picture(self.files[frame]))
        if self.store == "noisy":
            return image
        clean = self._sized(self.folder / CLEAN, _kept(self.folder / CLEAN))
        if image.shape != clean.shape:
            raise UserError(f"{self.files[frame]} has another size than {CLEAN}")
        image += clean
        key = _kept(self.folder / NOISE)
        add_noise(image, key.sigma, key.seed, frame % len(self))
        return image

    def __iter__(self) -> Iterator[Image]:
        """Pictures one by one."""
        return (self[frame] for frame in range(len(self)))

    @property
    def rest(self) -> Image:
        """Picture of the unloaded sensor."""
        if self.store == "noisy":
            return self._sized(self.folder / REST, read_picture(self.folder / REST))
        key = _kept(self.folder / NOISE)
        image = self._sized(self.folder / CLEAN, _kept(self.folder / CLEAN)).copy()
        add_noise(image, key.sigma, key.seed, key.rest)
        return image

    def png(self, frame: int) -> bytes:
        """PNG file of a frame's picture, the same bytes however it is kept."""
        image = self[frame]  # read in any case, as it may be damaged
        return self.files[frame].read_bytes() if self.store == "noisy" else encode_png(image)

    def _sized(self, path: Path, image: Image) -> Image:
        """The picture, which must have the size of all."""
        if self.size is not None and image.shape[:2] != self.size:
            height, width = self.size
            raise UserError(
                f"picture {path} has {image.shape[1]} × {image.shape[0]} pixels; the camera of "
                f"its scene has {width} × {height}"
            )
        return image


def pictures_in(folder: Path, size: tuple[int, int] | None = None) -> Pictures:
    """Pictures of a sequence's folder, of that height and width [px] where they are known."""
    store: Store = "clean" if (folder / NOISE).is_file() else "noisy"
    found = folder.glob(f"{FRAME[store]}-*.png")
    # From frame 1000 on a number has more digits.
    files = tuple(sorted(found, key=lambda path: (len(path.name), path.name)))
    return Pictures(folder=folder, files=files, store=store, size=size)


@contextmanager
def shown(folder: Path) -> Iterator[Path]:
    """Folder with the pictures of a sequence as files with noise: its own, or a temporary one.

    Parameters
    ----------
    folder: folder of the sequence
    """
    pictures = pictures_in(folder)
    if pictures.store == "noisy":
        yield folder
        return
    with tempfile.TemporaryDirectory() as temporary:
        (Path(temporary) / REST).write_bytes(encode_png(pictures.rest))
        for frame in range(len(pictures)):
            (Path(temporary) / f"frame-{frame:03d}.png").write_bytes(pictures.png(frame))
        yield Path(temporary)


def _kept(path: Path) -> Any:
    """Picture without noise, or key of the noise, of a sequence; kept for its next frame."""
    with disk_errors(path):
        return _read(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=16)
def _read(path: Path, changed: int) -> Any:
    """Read a file; `changed`, the time of its last change, is part of the cache's key."""
    return read_key(path.parent) if path.name == NOISE else read_picture(path)
