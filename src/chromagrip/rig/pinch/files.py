"""Files of a pinch's run folder."""

import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Self

from ...errors import UserError
from ...extras import need
from ...loop.run_folder import FILES, PARTS, scene_text
from ...loop.trace import Summary, Trace
from ...output.folder import leave, prepare
from ...output.frames import FRAMES, FrameFiles, FrameFormat
from ...output.logs.write import LOG_FILES, LogFormat, write_logs
from ...output.versions import versions
from ...render import Frame
from ...scene.scene import Scene
from .rig import PinchRig, PinchSample
from .trace import COLUMNS, FINGERS

if TYPE_CHECKING:
    from ...loop.shown.report import RunRead
    from .video import PinchVideo


class PinchFiles:
    """Files of a pinch, which get their names together, once all are written; a context.

    Until then they lie in a folder inside the run folder. After an error of the disk nothing of
    them is left.

    Parameters
    ----------
    folder: run folder, made if missing
    overwrite: remove an earlier run's files
    scene: that is run
    frames: how both cameras' raw pictures are kept; None does not keep them
    log: formats of the logs that are written after the other files

    Raises
    ------
    UserError
        When the folder cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        overwrite: bool,
        scene: Scene,
        frames: FrameFormat | None = None,
        log: Sequence[LogFormat] = (),
    ) -> None:
        self.folder = folder
        self._parts = folder / PARTS
        self._scene, self._log = scene, log
        self._video: PinchVideo | None = None
        self._frames: list[FrameFiles] = []
        prepare(folder, overwrite)
        with self._writing():
            self._discard()
            for name in (*FILES, *LOG_FILES):
                (folder / name).unlink(missing_ok=True)
            shutil.rmtree(folder / FRAMES, ignore_errors=True)
            self._parts.mkdir()
            self._video = _open_video(self._parts, scene)
            if frames is not None:
                (self._parts / FRAMES).mkdir()
                for name in FINGERS:
                    place = self._parts / FRAMES / name
                    self._frames.append(FrameFiles(place, frames, scene.camera.rate_hz))

    def __enter__(self) -> Self:
        """Use as a context, which removes unfinished files."""
        return self

    def __exit__(self, *_: object) -> None:
        """Remove unfinished files."""
        self._drop()

    def show(self, sample: PinchSample, rig: PinchRig) -> None:
        """Take a frame into the video, where one is due, and keep its pictures."""
        if self._video is None:  # writing failed
            return
        due = self._video.add(sample)
        came = bool(self._frames) and sample.readings[0].observation is not None
        if not (due or came):
            return
        pictures = rig.pictures()
        with self._writing():
            if came:
                self._keep(sample.index, pictures, rig)
            if due:
                self._video.show(sample, pictures)

    def _keep(self, index: int, pictures: tuple[Frame, Frame], rig: PinchRig) -> None:
        """Keep both cameras' raw pictures of a frame, and before the first those at rest."""
        if index == 0:
            for file, rest in zip(self._frames, rig.rest_pictures(), strict=True):
                file.add_rest(rest)
        for file, picture in zip(self._frames, pictures, strict=True):
            file.add(index, picture)

    def write(self, trace: Trace, summary: Summary) -> None:
        """Write the results, and give all files their names."""
        if self._video is None:  # writing failed before
            return
        with self._writing():
            self._video.close()
            for file in self._frames:
                file.close()
            _write_results(self._parts, self._scene, trace, summary)
            for part in sorted(self._parts.iterdir()):
                part.replace(self.folder / part.name)
        if self._log:
            from .log import log_of

            read = _as_read(self.folder, self._scene, trace, summary)
            write_logs(log_of(read), self.folder, self._log)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except UserError:  # of the video
            self._drop()
            raise
        except OSError as error:
            self._drop()
            reason = error.strerror or error
            raise UserError(f"folder {self.folder} cannot be written: {reason}") from None

    def _drop(self) -> None:
        """Remove unfinished files, and the folder where there are no others."""
        self._discard()
        leave(self.folder, "scene.toml")

    def _discard(self) -> None:
        """Close and remove unfinished files."""
        unfinished = (self._video, *self._frames)
        self._video, self._frames = None, []
        for file in unfinished:
            if file is not None:
                with suppress(OSError, UserError):
                    file.close()
        shutil.rmtree(self._parts, ignore_errors=True)


def _open_video(folder: Path, scene: Scene) -> "PinchVideo":
    from .video import PinchVideo

    return PinchVideo(folder / "tactile.mp4", scene)


def _write_results(folder: Path, scene: Scene, trace: Trace, summary: Summary) -> None:
    pa, pq = need("pyarrow", "data"), need("pyarrow.parquet", "data")

    from .figure import draw_figure
    from .report import write_report

    (folder / "scene.toml").write_text(scene_text(scene), encoding="utf-8")
    table = pa.table({name: pa.array(trace[name]) for name in COLUMNS})
    meaning = {name: words.encode() for name, words in COLUMNS.items()}
    pq.write_table(table.replace_schema_metadata(meaning), folder / "trace.parquet")
    draw_figure(scene, trace, folder / "figure.png")
    text = json.dumps({**summary, "versions": versions()}, indent=2)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8")
    write_report(_as_read(folder, scene, trace, summary))


def _as_read(folder: Path, scene: Scene, trace: Trace, summary: Summary) -> "RunRead":
    """What reading the folder would give."""
    from ...loop.shown.report import RunRead

    return RunRead(folder=folder, scene=scene, summary=summary, columns=trace.columns)
