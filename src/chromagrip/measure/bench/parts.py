"""Benches of all parts: figures beside their targets."""

from collections.abc import Callable, Sequence

from ...by_name import Choice
from ...errors import UserError
from ...output.report import Report
from ..domes.loop import bench_dome_loop
from ..domes.report import DOME, bench_domes
from ..pinches.bench import bench_pinches
from .control import bench_control
from .dataset import bench_dataset
from .force import bench_force
from .force_sets import choose
from .loop import bench_loop
from .model import bench_model
from .render import bench_render
from .track import bench_track

#: World of two fingers.
PINCH = "pinch"
PARTS: dict[str, Callable[..., Report]] = {
    "loop": bench_loop,
    "model": bench_model,
    "render": bench_render,
    "track": bench_track,
    "force": bench_force,
    "control": bench_control,
    "dataset": bench_dataset,
}


def bench(
    part: str,
    quick: bool,
    progress: Callable[[str], None],
    trackers: Sequence[Choice] = (),
    reconstructors: Sequence[Choice] = (),
    controllers: Sequence[str] = (),
    world: str = "",
    groups: Sequence[str] = (),
    scenes: Sequence[str] = (),
) -> Report:
    """Measure a part.

    Parameters
    ----------
    part: key of PARTS
    quick: measure less of everything
    progress: called with the name of each measurement
    trackers: of `track`: names, module:Class or classes; none are all
    reconstructors: of `force`: names, module:Class or classes; none are all
    controllers: of `control`: names or module:Class; none are all
    world, groups: of `force`: only this world, and only these groups of `beyond` or `dome`; of
        `loop`: the world `dome`, none is the chain; of `control`: the world `pinch`
    scenes: of `track`: only these

    Raises
    ------
    UserError
        When methods are given for another part, or there is no method of that name.
    """
    methods: dict[str, tuple[str, Sequence[Choice]]] = {
        "track": ("--tracker", trackers),
        "force": ("--reconstructor", reconstructors),
        "control": ("--controller", controllers),
    }
    for its_part, (option, choices) in methods.items():
        if choices and part != its_part:
            raise UserError(f"{option} goes with bench {its_part}, not with bench {part}")
    if part == "track":
        return bench_track(quick, progress, trackers, scenes)
    if scenes:
        raise UserError(f"--scene goes with bench track, not with bench {part}")
    if part == "force" and world == DOME:
        asked = choose(reconstructors) if reconstructors else {}
        return bench_domes(quick, progress, asked, groups)
    if part == "force":
        return bench_force(quick, progress, reconstructors, world, groups)
    if part == "loop" and world == DOME and not groups:
        return bench_dome_loop(quick, progress)
    if part == "control" and world == PINCH and not groups:
        return bench_pinches(quick, progress, controllers)
    if world or groups:
        given = f"--world {world}" if world else f"--group {groups[0]}"
        raise UserError(
            "--world and --group go with bench force, --world dome with bench loop, --world pinch "
            f"with bench control; got bench {part} {given}"
        )
    return PARTS[part](quick, progress, *(methods[part][1:] if part in methods else ()))
