"""Run a scene, in memory or into a run folder; or open one to grip it frame by frame."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, nullcontext
from pathlib import Path

from ..by_name import Choice
from ..control import Controller
from ..errors import UserError
from ..output.frames import FrameFormat
from ..output.logs.write import LogFormat, require_logs
from ..output.processes import one_thread
from ..scene.scene import Scene, load_scene
from .grasp import gripped
from .methods import choose
from .record import Record, Result
from .rig import Rig
from .run_files import RunFiles

#: Time in which a controller that is not ours must answer [s].
ANSWER_WITHIN_S = 60.0

#: Function called after each frame with the number of frames done and of all frames.
Progress = Callable[[int, int], None]


def run(
    scene: Scene | str,
    out: Path | str | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    controller: Choice | Controller | None = None,
    tracker: Choice | None = None,
    reconstructor: Choice | None = None,
    renderer: Choice | None = None,
    frames: FrameFormat | None = None,
    log: Sequence[LogFormat] = (),
    answer_within_s: float = ANSWER_WITHIN_S,
) -> Result:
    """Run a scene; with `out`, write summary, trace, figure, video and scene into that folder.

    After Ctrl-C or an error of a controller the results so far are written, marked as not
    complete, and the exception is raised.

    Parameters
    ----------
    scene: scene, or its name or file as in `load_scene`
    out: run folder, made if missing (default: no files are written)
    overwrite: whether to write into a folder that is not empty, over an earlier run's files
    progress: function called after every frame with the number of frames done and of all frames
    controller: controller in place of the scene's: an object with `reset` and `command`, a class or
        other factory without arguments, or a name
    tracker, reconstructor, renderer: methods in place of the scene's: a class or other factory, or
        a name
    frames: format in which the camera's raw pictures are kept in the folder `frames` of `out`, for
        two fingers in its folders `first` and `second` (default: they are not kept)
    log: formats in which the run is also written into `out`, for other tools: `mcap`, `rerun`
    answer_within_s: longest wait for a controller that is not ours; inf: no limit (default 60) [s]

    Returns
    -------
    results; with two fingers, summary and trace are those of a pinch

    Raises
    ------
    UserError
        For a scene, a method, a folder or a renderer that cannot be used.
    """
    within = check_asked(out, frames, log, answer_within_s)
    if isinstance(scene, str):
        scene = load_scene(scene)
    scene, methods = choose(
        scene,
        controller=controller,
        tracker=tracker,
        reconstructor=reconstructor,
        renderer=renderer,
    )
    methods.build_controller(scene)  # a controller that cannot be made leaves no folder
    rig = Rig(scene, methods)
    if out is not None:
        rig.open()  # a renderer that cannot run leaves no folder
    files = None if out is None else RunFiles(Path(out), overwrite, scene, frames, log)
    with files or nullcontext(), closing(rig), one_thread():
        return _recorded(rig, files, progress, within)


def _recorded(rig: Rig, files: RunFiles | None, progress: Progress | None, within: float) -> Result:
    """Run the loop, and write its results also after an interruption."""
    record = Record(rig.scene, rig.methods, rig.known[0], files)
    try:
        for sample in gripped(rig, within):
            record.add(sample, rig)
            if progress is not None:
                progress(sample.index + 1, rig.scene.frames)
    finally:
        result = record.finish()
    return result


def check_asked(
    out: Path | str | None,
    frames: FrameFormat | None,
    log: Sequence[LogFormat],
    answer_within_s: float,
) -> float:
    """Refuse arguments that contradict each other; returns the time limit of a controller [s]."""
    if frames is not None and out is None:
        raise UserError(f"pictures as {frames} need a folder: give `out`")
    if log and out is None:
        raise UserError(f"a log as {log[0]} needs a folder: give `out`")
    require_logs(log)
    if not answer_within_s > 0.0:
        raise UserError(f"answer_within_s = {answer_within_s} must be above 0; inf is no limit")
    return answer_within_s


@contextmanager
def open_rig(
    scene: Scene | str,
    *,
    tracker: Choice | None = None,
    reconstructor: Choice | None = None,
    renderer: Choice | None = None,
) -> Iterator[Rig]:
    """Open a scene to grip it frame by frame; a context, at whose end its cameras are closed.

    Inside it, BLAS, OpenMP and OpenCV have one thread in this process, as in a run.

    Parameters
    ----------
    scene: scene, or its name or file as in `load_scene`; its controller is not used
    tracker, reconstructor, renderer: methods in place of the scene's: a class or other factory, or
        a name

    Returns
    -------
    rig before its first `reset`

    Raises
    ------
    UserError
        For a scene or a method that cannot be used.
    """
    if isinstance(scene, str):
        scene = load_scene(scene)
    scene, methods = choose(scene, tracker=tracker, reconstructor=reconstructor, renderer=renderer)
    with ExitStack() as stack:
        stack.enter_context(one_thread())
        rig = Rig(scene, methods)
        stack.callback(rig.close)
        yield rig
