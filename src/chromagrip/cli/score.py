"""The command that scores anybody's tracks: `score`."""

import json
from pathlib import Path
from typing import Annotated

import tyro

from ..errors import UserError
from .options import FollowLinks, JsonOnly, Out, Overwrite, new_folder, option, status, stem_of


def score(
    files: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        option(
            "tracks of one maker or several, then the truth. Tracks are a file (Parquet, CSV, or "
            "TAP-Vid's .npz), a folder with one for each sequence, or a tracker to run; the truth "
            "is a dataset, one of its sequences, or such a file",
            "TRACKS... TRUTH",
        ),
    ],
    *,
    out: Out = None,
    overwrite: Overwrite = False,
    follow_links: FollowLinks = False,
    max_rows: Annotated[int, option("rows of a table that are read at most", "N")] = 20_000_000,
    json_only: JsonOnly = False,
) -> int:
    """Score tracks of any tracker against the truth of a dataset or of a file.

    Means over several sequences have bootstrap intervals of 90 %. Leaves leaderboard.html,
    scores.json and pictures of the worst frames.

    Example: chromagrip score mine.csv fit data/tracking
    """
    if len(files) < 2:
        raise UserError("score wants tracks and a truth: chromagrip score TRACKS... TRUTH")
    *tracks, truth = files
    if out is None and not json_only:
        out = new_folder(f"score-{stem_of(str(truth))}")

    from ..measure.scored.score import (
        as_json,
        case_tables,
        interval_note,
        refusals,
        score_table,
        score_tracks,
    )
    from ..output.report import table_lines

    with status() as report:
        outcomes = score_tracks(
            tracks, truth, out, overwrite, report, follow_links=follow_links, most=max_rows
        )
    if json_only:
        print(json.dumps(as_json(outcomes, truth)))
        return 0
    for table in (score_table(outcomes), *case_tables(outcomes)):
        print("\n".join(table_lines(table)))
    print(interval_note(outcomes))
    for sentence in refusals(outcomes):
        print(sentence)
    print(f"folder {out}, see leaderboard.html")
    return 0
