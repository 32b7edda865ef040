"""Running any scene, with one finger or with two."""

from collections.abc import Sequence
from pathlib import Path

from ..by_name import Choice
from ..control import Controller
from ..loop.run_folder import ANSWER_WITHIN_S, Progress, Result, run
from ..output.frames import FrameFormat
from ..output.logs.write import LogFormat
from ..scene.scene import Scene, load_scene
from .pinch.run import run_pinch


def run_scene(
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

    After Ctrl-C or an error of a controller the results up to there are written, marked as not
    complete, and the exception is raised.

    Parameters
    ----------
    scene: a Scene, or a name or file as in `load_scene`
    out: run folder, made if missing
    overwrite: write into a folder that is not empty, over an earlier run's files
    progress: called after every frame with the frames done and all frames
    controller: in place of the scene's: an object with `reset` and `command`, a class or other
        factory without arguments, or a name
    tracker, reconstructor, renderer: in place of the scene's: a class or other factory, or a name
    frames: keep the camera's raw pictures too, in the folder `frames` of `out`; of two fingers in
        its folders `first` and `second`
    log: formats in which the run is also written into `out`, for other tools: `mcap`, `rerun`
    answer_within_s: time in which a controller that is not ours must answer; inf is no limit

    Returns
    -------
    Results; those of two fingers have the summary and the trace of a pinch.

    Raises
    ------
    UserError
        For a scene, a method, a folder or a renderer that cannot be used.
    """
    if isinstance(scene, str):
        scene = load_scene(scene)
    run_it = run_pinch if scene.pinch.mass_g else run
    return run_it(
        scene, out, overwrite=overwrite, progress=progress, controller=controller,
        tracker=tracker, reconstructor=reconstructor, renderer=renderer, frames=frames,
        log=log, answer_within_s=answer_within_s,
    )  # fmt: skip
