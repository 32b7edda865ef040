"""The command's work: tracks of one maker or several, against one truth, in tables and pictures."""

import json
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ...by_name import method_meant
from ...errors import UserError, located
from ...folders import prepared, whole_file, write_whole
from ...output.page import PageSection, inline_png, write_page
from ...output.report import Table
from ...tracking import tracker_names
from .intervals import intervals
from .points import MOST_ROWS, SUFFIXES, read_points
from .scores import MEANING, UNITS, Scored, score, score_nothing
from .tracked import is_tracker, track_sequences
from .truths import Named, truths

Image = NDArray[np.uint8]

#: Frames whose errors are drawn.
_WORST = 4
#: Factors by which errors may be drawn longer than they are, and length of a typical one [px].
_FACTORS, _DRAWN = (1000.0, 300.0, 100.0, 30.0, 10.0, 3.0), 12.0
#: Share of points lost or invented up to which tracks are ranked by their error [%].
_GONE = 5.0
#: Order of the page.
_ORDER = (
    "The smallest error over the Cramér–Rao bound comes first. Tracks that lose or invent more "
    f"than {_GONE:g} % of the points, or whose bound is not known, come after them by average "
    "Jaccard. "
    "Errors of all tracks are drawn by the same factor, and beside it by one of their own where "
    "they are too small for it."
)
#: A truth, scores against it, and the number of a frame.
WorstFrame = tuple[Named, Scored, int]
#: Longest side of a drawn frame [px].
_SIDE = 640
_MISSED, _ERROR, _RIGHT = (215, 25, 30), (240, 130, 0), (0, 110, 200)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Scores of one maker's tracks.

    Attributes
    ----------
    name: of the tracks
    scores: mean over the sequences, by the names of UNITS
    intervals: bounds of these means, of 90 %; empty for one sequence
    sequences: scores of each sequence
    cases: of the recipe, by sequence; empty where there are none
    refused: sequences whose markers all count as lost, as the tracker cannot follow them; and why
    doubts: sequences whose tables seem to be wrong as a whole, and a sentence on it
    worst: picture of the worst frames; None where the truth has no pictures
    """

    name: str
    scores: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    sequences: dict[str, dict[str, float]]
    worst: Image | None
    cases: dict[str, str] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    doubts: dict[str, str] = field(default_factory=dict)


def score_tracks(
    tracks: Sequence[Path],
    truth: Path,
    out: Path | None,
    overwrite: bool,
    tell: Callable[[str], None] = lambda _: None,
    *,
    follow_links: bool = False,
    most: int = MOST_ROWS,
) -> list[Outcome]:
    """Score files or folders of tracks, or trackers by name, against one truth, the best first.

    The order is that of the error over the Cramér–Rao bound, see `leaderboard.html`.

    A tracker is run on the pictures of the truth, which is a dataset then, with the sensor's design
    as its palette.

    With `out` it leaves `scores.json`, `leaderboard.html` and, where the truth has pictures, one of
    the worst frames of each.

    Parameters
    ----------
    tracks, truth: files or folders, or names of trackers
    out: folder of the results
    overwrite: whether it may hold files
    tell: called with what is done
    follow_links: whether links in a dataset or a folder of tracks may lead out of it
    most: rows of a table that are read at most

    Raises
    ------
    UserError
        When tracks or truth cannot be read or are damaged, or are not of each other, or a tracker
        gives up.
    """
    for path in tracks:
        if not (is_tracker(str(path)) or path.exists()):
            file = path.suffix in SUFFIXES
            question = "" if file else method_meant(str(path), tracker_names())
            raise UserError(
                f"there is no {path}{question}; wanted: a file or a folder of tracks, or a "
                f"tracker: {', '.join(tracker_names())}, or module:Class"
            )
    if is_tracker(str(truth)):
        raise UserError(f"{truth} is a tracker, and stands before the truth: give {truth} DATA")
    with prepared(out, overwrite):
        with TemporaryDirectory() as temporary:
            outcomes = []
            for k, path in enumerate(tracks):
                own, refused = path, dict[str, str]()
                name = path.stem if path.is_file() else path.name
                if is_tracker(str(path)):
                    own, name = Path(temporary) / str(k), str(path)
                    refused = track_sequences(name, truth, own, tell, follow_links=follow_links)
                named = truths(own, truth, refused, follow_links=follow_links, most=most)
                outcomes.append(_outcome(name, refused, named, most, tell))
            ranked = sorted(_with_pictures(outcomes), key=_rank)
        if out is not None:
            _write(ranked, truth, out)
    return ranked


def _rank(outcome: Outcome) -> tuple[bool, float]:
    """Key of the order on the page, see `_ORDER`."""
    scores = outcome.scores
    follows = scores["lost"] + scores["false"] <= _GONE and np.isfinite(scores["bound"])
    return not follows, scores["bound"] if follows else -scores["jaccard"]


def _with_pictures(found: Sequence[tuple[Outcome, list[WorstFrame]]]) -> list[Outcome]:
    """Outcomes with pictures of their worst frames.

    All errors are drawn by the same factor, and to its right by the tracks' own if that is larger.
    """
    own = [min(map(_factor, frames), default=1.0) for _, frames in found]
    shared = min((f for f, (_, frames) in zip(own, found, strict=True) if frames), default=1.0)
    outcomes = []
    for (outcome, frames), factor in zip(found, own, strict=True):
        kinds = [(shared, "all tracks alike")] if len(found) > 1 else [(shared, "")]
        kinds += [(factor, "these tracks alone")] if factor > shared else []
        drawn = [_draw(*frame, *kind) for frame in frames for kind in kinds]
        outcomes.append(replace(outcome, worst=_tiled(drawn) if drawn else None))
    return outcomes


def _factor(frame: WorstFrame) -> float:
    """Largest of _FACTORS with which the typical error of a frame is drawn short enough."""
    named, scored, k = frame
    scale = _SIDE / max(named.pictures[k].shape[:2])
    typical = scale * np.nanmedian(np.append(np.linalg.norm(scored.error[k], axis=1), np.inf))
    return next((f for f in _FACTORS if f * typical < _DRAWN), 1.0)


def _outcome(
    name: str,
    refused: dict[str, str],
    named_truths: Iterable[Named],
    most: int,
    tell: Callable[[str], None],
) -> tuple[Outcome, list[WorstFrame]]:
    """Scores of one maker's tracks, and its worst frames that have pictures."""
    found: dict[str, dict[str, float]] = {}
    cases: dict[str, str] = {}
    doubts: dict[str, str] = {}
    frames: list[tuple[float, Named, Scored, int]] = []
    for named in named_truths:
        tell(f"{name}, {named.name}")
        if named.tracks is None:
            scored = score_nothing(named.truth)
        else:
            points = read_points(named.tracks, most=most)
            with located(f"tracks {named.tracks}"):
                scored = score(points, named.truth)
        found[named.name] = scored.scores
        cases |= {named.name: named.case} if named.case else {}
        doubts |= {named.name: scored.doubt} if scored.doubt else {}
        frames += [(bad, named, scored, k) for k, bad in enumerate(_badness(named, scored))]
        frames = sorted(frames, key=lambda entry: -entry[0])[:_WORST]
    outcome = Outcome(
        name=name,
        scores=_means(found),
        intervals=intervals(list(found.values())),
        sequences=found,
        cases=cases,
        refused=refused,
        doubts=doubts,
        worst=None,
    )
    return outcome, [(named, scored, k) for _, named, scored, k in frames if named.pictures]


def _badness(named: Named, scored: Scored) -> NDArray[np.float64]:
    """How bad each frame is: what is lost counts like an error of 8 px, shape (F,)."""
    visible = named.truth.points.visible
    length = np.linalg.norm(scored.error, axis=2)
    off = np.where(visible, np.where(np.isfinite(length), np.minimum(length, 8.0), 8.0), 0.0)
    return np.asarray(off.sum(axis=1) / np.maximum(visible.sum(axis=1), 1))


def _draw(named: Named, scored: Scored, k: int, longer: float, whose: str) -> Image:
    """A frame with its errors drawn by a factor, in the picture's own colours; whose it is."""
    picture = named.pictures[k]
    scale = _SIDE / max(picture.shape[:2])
    size = (round(scale * picture.shape[1]), round(scale * picture.shape[0]))
    drawn: Image = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    true, visible = named.truth.points.position[k], named.truth.points.visible[k]
    for at, error, seen in zip(true, scored.error[k], visible, strict=True):
        if not seen:
            continue
        start = scale * (at + 0.5) - 0.5
        if np.isfinite(error).all():
            end = start + scale * longer * error
            first, last = ([int(16 * v) for v in point] for point in (start, end))
            cv2.line(drawn, first, last, _ERROR, 2, cv2.LINE_AA, shift=4)
            cv2.circle(drawn, first, 24, _RIGHT, -1, cv2.LINE_AA, shift=4)
        else:
            x, y = round(start[0]), round(start[1])
            cv2.drawMarker(drawn, (x, y), _MISSED, cv2.MARKER_TILTED_CROSS, 10, 2, cv2.LINE_AA)
    lines = _captions(named, scored, k, f"x{longer:g}" + (f" ({whose})" if whose else ""))
    top = np.full((12 + 25 * len(lines), drawn.shape[1], 3), 255, np.uint8)
    for row, words in enumerate(lines):
        place = (8, 24 + 25 * row)
        cv2.putText(top, words, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, (20, 20, 20), 1, cv2.LINE_AA)
    return np.vstack([top, drawn])


def _captions(named: Named, scored: Scored, k: int, factor: str) -> tuple[str, ...]:
    """Lines above a drawn frame: what is lost, its errors in pixels, and how they are drawn."""
    visible = named.truth.points.visible[k]
    error = np.linalg.norm(scored.error[k], axis=1)[visible]
    found = error[np.isfinite(error)]
    sizes = (
        f"error: median {np.median(found):.2g} px, largest {found.max():.2g} px"
        if len(found)
        else "no marker was found"
    )
    lost = len(error) - len(found)
    return (
        f"{named.name}, frame {k}: {lost} of {len(error)} lost (red crosses)",
        sizes,
        f"blue: true place; orange: error {factor}",
    )


def _tiled(pictures: list[Image]) -> Image:
    """Pictures in two columns."""
    height, width = (max(p.shape[k] for p in pictures) for k in (0, 1))
    cells = [
        cv2.copyMakeBorder(
            p, 0, height - p.shape[0], 0, width - p.shape[1], cv2.BORDER_CONSTANT, value=(255,) * 3
        )
        for p in pictures
    ]
    if len(cells) == 1:
        return np.asarray(cells[0])
    if len(cells) % 2:
        cells.append(np.full_like(cells[0], 255))
    rows = [np.hstack(cells[k : k + 2]) for k in range(0, len(cells), 2)]
    return np.vstack(rows)


def score_table(outcomes: Sequence[Outcome]) -> Table:
    """A line for each score, with what it means, and a column for each maker's tracks."""
    header = ("score", *(outcome.name for outcome in outcomes), "")
    lines = tuple(
        (f"{name} {unit}".strip(), *(_with_bounds(o, name) for o in outcomes), MEANING[name])
        for name, unit in UNITS.items()
    )
    return Table(header, lines)


def case_tables(outcomes: Sequence[Outcome]) -> list[Table]:
    """Error and losses in each case of a recipe, a column for each maker; none without cases."""
    cases = dict.fromkeys(case for outcome in outcomes for case in outcome.cases.values())
    tables = []
    for name in ("rms", "lost") if cases else ():
        header = (f"{name} {UNITS[name]}", *(outcome.name for outcome in outcomes))
        lines = tuple(
            (case, *(_with_bounds(_of_case(outcome, case), name) for outcome in outcomes))
            for case in cases
        )
        tables.append(Table(header, lines))
    return tables


def _of_case(outcome: Outcome, case: str) -> Outcome:
    """The sequences of one case alone."""
    own = {name: outcome.sequences[name] for name, of in outcome.cases.items() if of == case}
    return replace(outcome, sequences=own, scores=_means(own), intervals=intervals([*own.values()]))


def _means(sequences: dict[str, dict[str, float]]) -> dict[str, float]:
    """Mean of each score over the sequences that have it."""
    found = {name: [s[name] for s in sequences.values() if name in s] for name in UNITS}
    return {name: float(np.mean(each)) if each else np.nan for name, each in found.items()}


def _with_bounds(outcome: Outcome, name: str) -> str:
    """A mean score with its interval, where it has one."""
    mean = words(outcome.scores[name])
    if name not in outcome.intervals or not np.isfinite(outcome.scores[name]):
        return mean
    low, high = (words(bound) for bound in outcome.intervals[name])
    return f"{mean} ({low} … {high})"


def interval_note(outcomes: Sequence[Outcome]) -> str:
    """What the intervals are, or why there are none."""
    counts = {len(outcome.sequences) for outcome in outcomes}
    if counts == {1}:
        return "One sequence: there are no intervals."
    of = " or ".join(str(count) for count in sorted(counts))
    return f"Means over {of} sequences; in brackets bootstrap intervals of 90 % over sequences."


def refusals(outcomes: Sequence[Outcome]) -> list[str]:
    """Sentences on tables that seem wrong, and on trackers that cannot follow some sequences."""
    doubts = [
        f"{outcome.name}, {', '.join(outcome.doubts)}: {next(iter(outcome.doubts.values()))}"
        for outcome in outcomes
        if outcome.doubts
    ]
    return doubts + [
        f"{outcome.name} cannot follow {', '.join(outcome.refused)}, whose markers count as lost: "
        f"{next(iter(outcome.refused.values()))}"
        for outcome in outcomes
        if outcome.refused
    ]


def as_json(outcomes: Sequence[Outcome], truth: Path) -> dict[str, object]:
    """Plain values of `scores.json`; null for what is not known."""
    tracks = [
        {
            "tracks": outcome.name,
            "scores": _plain(outcome.scores),
            "intervals": {
                name: [low, high] if np.isfinite([low, high]).all() else None
                for name, (low, high) in outcome.intervals.items()
            },
            "cases": outcome.cases,
            "refused": outcome.refused,
            "doubts": outcome.doubts,
            "sequences": {name: _plain(scores) for name, scores in outcome.sequences.items()},
        }
        for outcome in outcomes
    ]
    return {"truth": str(truth), "units": UNITS, "tracks": tracks}


def words(value: float) -> str:
    """A score in text."""
    return "–" if not np.isfinite(value) else f"{value:.3g}"


def _write(outcomes: Sequence[Outcome], truth: Path, out: Path) -> None:
    text = json.dumps(as_json(outcomes, truth), indent=2) + "\n"
    sections = [
        PageSection(
            anchor="means",
            name="means",
            title="Means",
            picture=Markup(),
            sentence=" ".join([interval_note(outcomes), *refusals(outcomes)]),
            tables=(score_table(outcomes), *case_tables(outcomes)),
        )
    ]
    for k, outcome in enumerate(outcomes):
        picture = Markup()
        if outcome.worst is not None:
            data = cv2.imencode(".png", outcome.worst[..., ::-1])[1].tobytes()
            file = re.sub(r"[^\w.=-]+", "-", outcome.name)  # of a module:Class(name=value)
            write_whole(out / f"worst-{file}.png", data)
            picture = inline_png(data, f"worst frames of {outcome.name}")
        lines = tuple(
            (name, *(words(scores.get(key, np.nan)) for key in UNITS))
            for name, scores in outcome.sequences.items()
        )
        header = ("sequence", *(f"{name} {unit}".strip() for name, unit in UNITS.items()))
        sections.append(
            PageSection(
                anchor=f"tracks-{k}",
                name=outcome.name,
                title=f"{k + 1}. {outcome.name}",
                picture=picture,
                sentence=f"{words(outcome.scores['bound'])} × the Cramér–Rao bound, "
                f"average Jaccard {words(outcome.scores['jaccard'])} %.",
                tables=(Table(header, lines),),
            )
        )
    with whole_file(out / "leaderboard.html") as part:
        title = f"Tracks scored against {truth.name}"
        write_page(part, title, (_ORDER,), sections)
    write_whole(out / "scores.json", text.encode())


def _plain(scores: dict[str, float]) -> dict[str, float | None]:
    return {name: value if np.isfinite(value) else None for name, value in scores.items()}
