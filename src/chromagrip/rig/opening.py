"""Opening a scene to grip it frame by frame, with one finger or with two."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from ..by_name import Choice
from ..loop.methods import choose
from ..loop.rig import Rig
from ..output.processes import one_thread
from ..scene.scene import Scene, load_scene


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
    scene: a Scene, or a name or file as in `load_scene`; its controller is not used
    tracker, reconstructor, renderer: in place of the scene's: a class or other factory, or a name

    Returns
    -------
    The rig.

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
