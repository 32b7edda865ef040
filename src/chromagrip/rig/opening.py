"""Opening a scene to grip it frame by frame, with one finger or with two."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from ..by_name import Choice
from ..loop.methods import Methods, choose
from ..loop.steps.rig import Rig, readable
from ..output.processes import one_thread
from ..scene.scene import Scene, load_scene
from .pinch.rig import PinchRig


def rig_of(scene: Scene, methods: Methods) -> Rig | PinchRig:
    """Rig of a scene: with two fingers where it is a pinch.

    Raises
    ------
    UserError
        For a scene that cannot be gripped, and a reconstructor that cannot read it.
    """
    if scene.pinch.mass_g:
        return PinchRig(scene, methods)
    return Rig(scene, methods, known=readable(scene, methods))


@contextmanager
def open_rig(
    scene: Scene | str,
    *,
    tracker: Choice | None = None,
    reconstructor: Choice | None = None,
    renderer: Choice | None = None,
) -> Iterator[Any]:
    """Open a scene to grip it frame by frame; a context, at whose end its cameras are closed.

    Inside it, BLAS, OpenMP and OpenCV have one thread in this process, as in a run.

    Parameters
    ----------
    scene: a Scene, or a name or file as in `load_scene`; its controller is not used
    tracker, reconstructor, renderer: in place of the scene's: a class or other factory, or a name

    Returns
    -------
    A `Rig`, or a `PinchRig` of a scene of two fingers. Which one, only the scene says.

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
        rig = rig_of(scene, methods)
        stack.callback(rig.close)
        yield rig
