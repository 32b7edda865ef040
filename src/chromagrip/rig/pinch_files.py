"""Files of a pinch's run folder."""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Self

from ..errors import UserError
from ..extras import need
from ..loop.run_folder import scene_text
from ..loop.trace import Summary, Trace
from ..output.folder import prepare
from ..output.versions import versions
from ..scene.scene import Scene
from .pinch_rig import PinchRig, PinchSample
from .pinch_trace import COLUMNS

if TYPE_CHECKING:
    from .pinch_video import PinchVideo

#: Files of a run folder.
FILES = ("summary.json", "trace.parquet", "figure.png", "tactile.mp4", "scene.toml")


class PinchFiles:
    """Files of a pinch, which get their names together, once all are written; a context.

    Until then they lie in a folder inside the run folder. After an error of the disk nothing of
    them is left.

    Parameters
    ----------
    folder: run folder, made if missing
    overwrite: remove an earlier run's files
    scene: that is run

    Raises
    ------
    UserError
        When the folder cannot be written.
    """

    def __init__(self, folder: Path, overwrite: bool, scene: Scene) -> None:
        self.folder = folder
        self._parts = folder / ".parts"
        self._scene = scene
        self._video: PinchVideo | None = None
        prepare(folder, overwrite)
        with self._writing():
            self._discard()
            for name in FILES:
                (folder / name).unlink(missing_ok=True)
            self._parts.mkdir()
            self._video = _open_video(self._parts, scene)

    def __enter__(self) -> Self:
        """Use as a context, which removes unfinished files."""
        return self

    def __exit__(self, *_: object) -> None:
        """Remove unfinished files."""
        self._discard()

    def show(self, sample: PinchSample, rig: PinchRig) -> None:
        """Take a frame into the video, which has a picture where one is due."""
        if self._video is None:  # writing failed
            return
        if self._video.add(sample):
            frames = rig.pictures()
            with self._writing():
                self._video.show(sample, frames)

    def write(self, trace: Trace, summary: Summary) -> None:
        """Write the results, and give all files their names."""
        if self._video is None:  # writing failed before
            return
        with self._writing():
            self._video.close()
            _write_results(self._parts, self._scene, trace, summary)
            for part in sorted(self._parts.iterdir()):
                part.replace(self.folder / part.name)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except UserError:  # of the video
            self._discard()
            raise
        except OSError as error:
            self._discard()
            reason = error.strerror or error
            raise UserError(f"folder {self.folder} cannot be written: {reason}") from None

    def _discard(self) -> None:
        """Close and remove unfinished files."""
        video, self._video = self._video, None
        if video is not None:
            with suppress(OSError, UserError):
                video.close()
        shutil.rmtree(self._parts, ignore_errors=True)


def _open_video(folder: Path, scene: Scene) -> "PinchVideo":
    from .pinch_video import PinchVideo

    return PinchVideo(folder / "tactile.mp4", scene)


def _write_results(folder: Path, scene: Scene, trace: Trace, summary: Summary) -> None:
    pa, pq = need("pyarrow", "data"), need("pyarrow.parquet", "data")

    from .pinch_figure import draw_figure

    (folder / "scene.toml").write_text(scene_text(scene), encoding="utf-8")
    table = pa.table({name: pa.array(trace[name]) for name in COLUMNS})
    meaning = {name: words.encode() for name, words in COLUMNS.items()}
    pq.write_table(table.replace_schema_metadata(meaning), folder / "trace.parquet")
    draw_figure(scene, trace, folder / "figure.png")
    text = json.dumps({**summary, "versions": versions()}, indent=2)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
