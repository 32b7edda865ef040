"""Pictures of a sequence: rest.png, and frame-000.png, … of its frames."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..sources.picture_files import read_picture

Image = NDArray[np.uint8]
#: Name of the picture of the unloaded sensor.
REST = "rest.png"


@dataclass(frozen=True, kw_only=True)
class Pictures:
    """Pictures of the frames of a sequence, RGB, shape (H, W, 3), read on demand.

    Attributes
    ----------
    folder: folder of the sequence
    files: file of each frame, in order
    size: height and width of each [px]; None if they are unknown
    """

    folder: Path
    files: tuple[Path, ...]
    size: tuple[int, int] | None = None

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.files)

    def __getitem__(self, frame: int) -> Image:
        """Picture of a frame."""
        return self._read(self.files[frame])

    def __iter__(self) -> Iterator[Image]:
        """Pictures one by one."""
        return (self[frame] for frame in range(len(self)))

    @property
    def rest(self) -> Image:
        """Picture of the unloaded sensor."""
        return self._read(self.folder / REST)

    def _read(self, path: Path) -> Image:
        """Picture of a file, which must have the size of all."""
        image = read_picture(path)
        if self.size is not None and image.shape[:2] != self.size:
            height, width = self.size
            raise UserError(
                f"picture {path} has {image.shape[1]} × {image.shape[0]} pixels; the camera of "
                f"its scene has {width} × {height}"
            )
        return image


def pictures_in(folder: Path, size: tuple[int, int] | None = None) -> Pictures:
    """Pictures of a sequence's folder, of that height and width [px] where they are known."""
    # From frame 1000 on a number has more digits.
    files = sorted(folder.glob("frame-*.png"), key=lambda path: (len(path.name), path.name))
    return Pictures(folder=folder, files=tuple(files), size=size)
