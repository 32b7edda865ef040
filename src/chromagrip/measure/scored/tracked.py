"""Tracks by a tracker that is run on the sequences of a dataset."""

from collections.abc import Callable
from pathlib import Path

from ...dataset.folder import FILES, read_manifest
from ...dataset.pictures import REST, shown
from ...errors import UserError
from ...pictures.track import track_source
from ...scene.scene import load_scene
from ...tracking import tracker_names


def is_tracker(name: str) -> bool:
    """Whether tracks are named by their tracker, not by a file or folder."""
    return not Path(name).exists() and (":" in name or name in tracker_names())


def track_sequences(
    tracker: str, truth: Path, out: Path, tell: Callable[[str], None] = lambda _: None
) -> tuple[Path, dict[str, str]]:
    """Run a tracker that knows the sensor's design on a dataset or a sequence.

    Returns
    -------
    folder: of its tracks
    refused: sequences that it cannot follow, with the reason

    Raises
    ------
    UserError
        When the truth is no dataset, or the tracker cannot follow any sequence of it.
    """
    refused: dict[str, str] = {}
    alone = (truth / FILES).is_file()
    names = [truth.name] if alone else list(read_manifest(truth)["sequences"])
    for name in names:
        tell(f"{tracker} follows {name}")
        where, to = truth if alone else truth / name, out / tracker / name
        design = load_scene(str(where / "scene.toml")).sensor
        with shown(where) as source:
            try:
                outcome = track_source(
                    str(source / REST), str(source), palette=design, tracker=tracker, out=to
                )
                if outcome.broken is not None:
                    raise UserError(outcome.broken)
            except UserError as error:
                refused[name] = str(error).replace(f"{source}/", "")
                if len(refused) == len(names):
                    raise UserError(f"{tracker}, {name}: {refused[name]}") from None
    return out / tracker, refused
