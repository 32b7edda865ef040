"""Tracks by a tracker that is run on the sequences of a dataset."""

from collections.abc import Callable
from pathlib import Path

from ...dataset.folder import sequence_name
from ...dataset.pictures import REST
from ...dataset.read import verified
from ...errors import UserError
from ...pictures.track import track_source
from ...tracking import tracker_names
from .truths import sequences_of


def is_tracker(name: str) -> bool:
    """Whether tracks are named by their tracker, not by a file or folder."""
    return not Path(name).exists() and (":" in name or name in tracker_names())


def track_sequences(
    tracker: str,
    truth: Path,
    out: Path,
    tell: Callable[[str], None] = lambda _: None,
    *,
    follow_links: bool = False,
) -> dict[str, str]:
    """Run a tracker that knows the sensor's design on a dataset or a sequence.

    Parameters
    ----------
    out: folder of its tracks

    Returns
    -------
    refused: sequences that it cannot follow, with the reason

    Raises
    ------
    UserError
        When the truth is no dataset or is damaged, or the tracker cannot follow any sequence of it.
    """
    refused: dict[str, str] = {}
    dataset, names = sequences_of(truth, follow_links)
    for one in verified(dataset, names):
        where, name = one.pictures.folder, sequence_name(one.number)
        tell(f"{tracker} follows {name}")
        to, design = out / name, one.scene.sensor
        try:
            outcome = track_source(
                str(where / REST), str(where), palette=design, tracker=tracker, out=to
            )
            if outcome.broken is not None:
                raise UserError(outcome.broken)
        except UserError as error:
            for _ in one.pictures:
                pass  # a picture that cannot be read is not the tracker's fault
            refused[name] = str(error).replace(f"{where}/", "")
            if len(refused) == len(names):
                raise UserError(f"{tracker}, {name}: {refused[name]}") from None
    return refused
