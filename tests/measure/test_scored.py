"""Scores of anybody's tracks, against truths that are known in closed form."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from chromagrip.errors import UserError
from chromagrip.measure.score.intervals import intervals
from chromagrip.measure.score.points import Points, read_points
from chromagrip.measure.score.score import (
    Outcome,
    _captions,
    _factor,
    _rank,
    _with_pictures,
    as_json,
    case_tables,
    interval_note,
    score_table,
)
from chromagrip.measure.score.scores import UNITS, Scored, Truth, score, score_nothing
from chromagrip.measure.score.truths import Named

Typed = Callable[..., CompletedProcess[str]]
FRAMES, COUNT = 6, 30
WORDS = ("frame", "marker", "x_px", "y_px")


def moving(seed: int = 0) -> Points:
    """Points on a grid of 20 px that move by 2 px a frame."""
    x, y = np.meshgrid(np.arange(6) * 20.0, np.arange(5) * 20.0)
    start = np.stack([x.ravel(), y.ravel()], axis=-1)
    position = start + 2.0 * np.arange(FRAMES)[:, None, None]
    visible = np.ones((FRAMES, COUNT), dtype=bool)
    return Points(names=[("", k) for k in range(COUNT)], position=position, visible=visible)


def seen(points: Points, visible: np.ndarray) -> Points:
    position = np.where(visible[..., None], points.position, np.nan)
    return replace(points, position=position, visible=visible)


def off(points: Points, by: object) -> Points:
    """The same points at other places."""
    return replace(points, position=points.position + np.asarray(by))


def test_the_truth_itself_has_no_error_under_any_numbers() -> None:
    true = moving()
    order = np.random.default_rng(1).permutation(COUNT)
    shuffled = Points(
        names=[("", 7 * k) for k in range(COUNT)],
        position=true.position[:, order],
        visible=true.visible[:, order],
    )
    scores = score(shuffled, Truth(points=true)).scores
    assert scores["rms"] == scores["bias"] == scores["lost"] == scores["swaps"] == 0.0
    assert scores["jaccard"] == scores["within"] == scores["occlusion"] == 100.0
    assert np.isnan(scores["rms_mm"])
    assert np.isnan(scores["bound"])


@settings(max_examples=4)
@given(deviation=st.floats(0.01, 0.4), dx=st.floats(-0.5, 0.5))
def test_noise_and_offset_are_found_as_large_as_they_are(deviation: float, dx: float) -> None:
    true = moving()
    noise = deviation * np.random.default_rng(2).standard_normal(true.position.shape)
    found = off(true, noise + np.array([dx, 0.0]))
    bound, scale = np.full(COUNT, 0.5 * deviation), np.full(COUNT, 0.1)
    scores = score(found, Truth(points=true, mm_per_px=scale, bound=bound)).scores
    expected = np.sqrt(deviation**2 + dx**2 / 2.0)
    assert scores["rms"] == pytest.approx(expected, rel=0.15)
    assert scores["bias"] == pytest.approx(abs(dx), abs=0.3 * deviation)
    assert scores["rms_mm"] == pytest.approx(0.1 * scores["rms"])
    assert scores["bound"] == pytest.approx(2.0 * scores["rms"] / deviation)


def test_lost_false_and_swapped_points_are_counted() -> None:
    true = moving()
    hidden = true.visible.copy()
    hidden[3, :6] = False  # six points of a frame are not visible
    reported = true.visible.copy()
    reported[4, :3] = False  # three others are lost
    position = true.position.copy()
    position[5, [0, 1]] = position[5, [1, 0]]  # two are exchanged
    found = seen(replace(true, position=position), reported)
    scores = score(found, Truth(points=seen(true, hidden))).scores
    visible = FRAMES * COUNT - 6
    assert scores["lost"] == pytest.approx(100.0 * 3 / visible)
    assert scores["false"] == pytest.approx(100.0 * 6 / (visible - 3 + 6))
    assert scores["swaps"] == 2
    assert scores["occlusion"] == pytest.approx(100.0 * (1.0 - 9 / (FRAMES * COUNT)))


def test_tap_vids_scores_are_those_of_its_definition() -> None:
    """All points off by 3 px: two of the five distances are missed."""
    scores = score(off(moving(), [3.0, 0.0]), Truth(points=moving())).scores
    assert scores["within"] == pytest.approx(100.0 * 3 / 5)
    assert scores["jaccard"] == pytest.approx(100.0 * 3 / 5)


def table(points: Points, words: tuple[str, ...] = WORDS) -> pd.DataFrame:
    frame, point = np.divmod(np.arange(points.visible.size), len(points.names))
    numbers = np.array([number for _, number in points.names])[point]
    columns = (frame, numbers, *points.position.reshape(-1, 2).T)
    return pd.DataFrame(dict(zip(words, columns, strict=True)))


def write(path: Path, points: Points, words: tuple[str, ...] = WORDS) -> Path:
    """Write a table or arrays, by the file's ending."""
    rows = table(points, words)
    if path.suffix == ".csv":
        rows[points.visible.ravel()].to_csv(path, index=False)
    elif path.suffix == ".parquet":
        rows.assign(visible=points.visible.ravel()).to_parquet(path)
    else:
        tracks = np.nan_to_num(np.swapaxes(points.position, 0, 1))
        np.savez(path, tracks=tracks, visibles=points.visible.T)
    return path


def test_every_format_says_the_same(tmp_path: Path) -> None:
    visible = np.random.default_rng(5).random((FRAMES, COUNT)) > 0.1
    points = seen(moving(), visible)
    write(tmp_path / "other.csv", points, ("frame", "track", "x", "y"))
    for name in ("a.csv", "c.parquet", "d.npz"):
        write(tmp_path / name, points)
    for file in tmp_path.iterdir():
        found = read_points(file)
        assert (found.visible == points.visible).all()
        np.testing.assert_allclose(found.position, points.position)


@pytest.mark.parametrize(("mark", "case"), [("", str), ("\ufeff", str.upper)])
def test_tables_of_other_programs_are_read(
    tmp_path: Path, mark: str, case: Callable[[str], str]
) -> None:
    """With trackpy's columns and index, and TrackMate's with three more rows of names and units."""
    points = seen(moving(), np.random.default_rng(8).random((FRAMES, COUNT)) > 0.1)
    rows = [(k, n, *points.position[k, n]) for k, n in np.argwhere(points.visible).tolist()]
    trackpy = [",".join(map(case, ("", "y", "x", "mass", "frame", "particle")))]
    trackpy += [f"{i},{y},{x},41.5,{k},{n}.0" for i, (k, n, x, y) in enumerate(rows)]
    columns = ("label", "id", "track_id", "position_x", "position_y", "frame")
    trackmate = [",".join(map(case, columns)), *["Label,Spot ID,Track ID,X,Y,Frame"] * 2]
    trackmate += [",,,(pixel),(pixel),"]
    trackmate += [f"ID{i},{i},{n},{x},{y},{k}" for i, (k, n, x, y) in enumerate(rows)]
    trackmate += ["ID900,900,,3.5,4.5,0", "ID901,901,None,3.5,4.5,0"]  # spots in no track
    bare = [trackmate[0], *trackmate[4:]]  # of a script that writes one row of names
    for lines in (trackpy, trackmate, bare):
        path = tmp_path / "theirs.csv"
        path.write_text(mark + "\n".join(lines) + "\n", encoding="utf-8")
        found = read_points(path)
        assert (found.visible == points.visible).all()
        np.testing.assert_allclose(found.position, points.position)
    path.write_text("\n".join(trackmate).replace("pixel", "micron"), encoding="utf-8")
    with pytest.raises(UserError, match="its places are in micron; wanted: pixels"):
        read_points(path)
    arrays = {"tracks": np.swapaxes(points.position, 0, 1), "occluded": ~points.visible.T}
    np.savez(tmp_path / "tap.npz", **{case(name): array for name, array in arrays.items()})
    assert (read_points(tmp_path / "tap.npz").visible == points.visible).all()


def test_what_are_no_tracks_is_refused(tmp_path: Path) -> None:
    for name, text, told in (
        ("a.txt", "", "expected a file that ends in .parquet, .csv, .npz"),
        ("a.csv", "frame,x,y\n0,1,2\n", "has no column marker or point or particle or"),
        ("a.csv", "frame;marker;x;y\n0;1;2;3\n", "separated by semicolons; expected commas"),
        ("a.csv", "frame,id,x,y\n", "has no row"),
        ("a.csv", "frame,id,x,y\n0,1,2,2\n0,2,far,2\n", "row 2, column x: 'far' is no num"),
        ("a.csv", "frame,id,x,y\n0,1.5,2,2\n", "row 1, column id: '1.5' is no whole number"),
        ("a.csv", "frame,id,x,y,visible\n0,1,2,2,perhaps\n", "'perhaps' is no true or false"),
        ("a.csv", "frame,id,x,y\n3,1,2,2\n3,1,2,2\n", "1 rows repeat another one"),
        ("a.csv", "frame,id,x,y\n-1,1,2,2\n", "a frame before 0"),
    ):
        (tmp_path / name).write_text(text, encoding="utf-8")
        with pytest.raises(UserError, match=rf"^tracks {tmp_path}/{name}: .*{told}"):
            read_points(tmp_path / name, "tracks")


def layered(points: Points, *names: str) -> Points:
    """The same points once for each layer, as markers that lie on each other."""
    return Points(
        names=[(name, k) for name in names for _, k in points.names],
        position=np.concatenate([points.position] * len(names), axis=1),
        visible=np.concatenate([points.visible] * len(names), axis=1),
    )


def test_layers_that_are_not_told_are_asked_for(tmp_path: Path) -> None:
    """Points of one place cannot be given to layers by chance: half of them would be lost."""
    points = layered(moving(), "magenta", "yellow")
    truth = Truth(points=points)
    for found, words in ((moving(), "no layer"), (layered(moving(), "a", "b"), "layer a and b")):
        with pytest.raises(UserError, match=rf"have (the )?{words}.* magenta and yellow"):
            score(found, truth)
    assert score(layered(moving(), "magenta"), truth).scores["lost"] == 50.0
    assert score(points, truth).scores["lost"] == 0.0
    arrays = {"tracks": np.swapaxes(points.position, 0, 1), "visibles": points.visible.T}
    np.savez(tmp_path / "a.npz", **arrays, layer=points.layers.astype(str))
    assert (read_points(tmp_path / "a.npz").layers == points.layers).all()
    np.savez(tmp_path / "b.npz", **arrays, layer=["magenta"])
    with pytest.raises(UserError, match=r"b.npz: its array layer names 1 of 60 points"):
        read_points(tmp_path / "b.npz")


@pytest.mark.studies
def test_the_command_ranks_trackers_on_a_dataset(tmp_path: Path, typed: Typed) -> None:
    """Our own tracker near the bound, beside one that says that nothing moves."""
    data, out = tmp_path / "data", tmp_path / "scores"
    assert typed("dataset", "make", "tiny", "--n", 2, "--out", data).returncode == 0
    sequence = data / "sequence-000000"
    for tracker in ("fit", "lk"):
        words = ("track", sequence / "rest.png", sequence, "--palette", "thesis")
        folder = tmp_path / tracker
        assert typed(*words, "--tracker", tracker, "--out", folder).returncode == 0
        (folder / "tracks.parquet").rename(tmp_path / f"{tracker}.parquet")
    files = [tmp_path / "lk.parquet", tmp_path / "fit.parquet"]
    told = json.loads(typed("score", *files, sequence, "--out", out, "--json").stdout)
    assert told == json.loads((out / "scores.json").read_text(encoding="utf-8"))
    found = {entry["tracks"]: entry["scores"] for entry in told["tracks"]}
    assert 0.8 < found["fit"]["bound"] < 1.6
    assert list(found) == ["fit", "lk"]  # by the error over the bound
    assert found["fit"]["rms"] < found["lk"]["rms"]
    assert [entry["doubts"] for entry in told["tracks"]] == [{}, {}]
    assert found["fit"]["rms_mm"] == pytest.approx(found["fit"]["rms"] * 0.044, rel=0.3)
    page = (out / "leaderboard.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 2
    assert (out / "worst-fit.png").is_file()
    # A tracker of one's own by its name, which has characters that a file's may not have.
    (tmp_path / "still.py").write_text(
        "from chromagrip.tracking.baselines.flow import LucasKanade as Still\n"
    )
    assert typed("score", "still:Still", sequence, "--out", "own-scores").returncode == 0
    assert (tmp_path / "own-scores" / "worst-still-Still.png").is_file()
    # Which of two sequences is not guessed.
    done = typed("score", files[0], data, "--out", tmp_path / "none")
    assert (done.returncode, "has 2 sequences; give the one" in done.stderr) == (2, True)
    assert not (tmp_path / "none").exists()


def rms_of(values: np.ndarray) -> list[dict[str, float]]:
    return [{"rms": value} for value in values]


def test_intervals_are_those_of_means_and_hold_as_often_as_they_say() -> None:
    """By the central limit theorem: mean ± 1.645 σ/√n."""
    values = np.random.default_rng(3).exponential(2.0, 400)
    low, high = intervals(rms_of(values))["rms"]
    half = 1.645 * values.std() / np.sqrt(len(values))
    assert (low + high) / 2.0 == pytest.approx(values.mean(), abs=0.15 * half)
    assert (high - low) / 2.0 == pytest.approx(half, rel=0.1)
    # Of 30 sequences a bootstrap of percentiles covers slightly less than its 90 %.
    rng = np.random.default_rng(4)
    bounds = [intervals(rms_of(rng.normal(1.0, 0.5, 30)))["rms"] for _ in range(200)]
    assert 0.84 < np.mean([low < 1.0 < high for low, high in bounds]) < 0.94
    # Two makers are judged on the same draws: better by the same everywhere is so at both bounds.
    scores = [{"rms": value, "p95": value + 0.25, "bound": 3.0} for value in values[:12]]
    found = intervals(scores)
    np.testing.assert_allclose(np.subtract(found["p95"], found["rms"]), 0.25)
    assert found["bound"] == pytest.approx((3.0, 3.0))
    assert np.isnan(intervals([*scores, {**scores[0], "rms": np.nan}])["rms"]).all()


def test_a_sequence_that_is_not_followed_counts_as_lost_and_has_no_error() -> None:
    nothing = score_nothing(Truth(points=moving())).scores
    assert (nothing["lost"], nothing["jaccard"], nothing["within"]) == (100.0, 0.0, 0.0)
    assert "rms" not in nothing
    values = np.random.default_rng(6).exponential(1.0, 11)
    followed = [{"rms": value, "lost": 1.0} for value in values]
    found = intervals([*followed, {"lost": 100.0}])
    alone = intervals(followed)
    assert found["rms"] == pytest.approx(alone["rms"], rel=0.1)
    assert found["lost"][1] > alone["lost"][1] == 1.0


def of_names(name: str, values: list[float]) -> Outcome:
    found = {f"sequence-{k:06d}": dict.fromkeys(UNITS, value) for k, value in enumerate(values)}
    mean = dict.fromkeys(UNITS, float(np.mean(values)))
    bounds = intervals(list(found.values()))
    return Outcome(name=name, scores=mean, intervals=bounds, sequences=found, worst=None)


def test_tracks_are_ranked_by_the_bound_and_what_is_lost_comes_last() -> None:
    def outcome(name: str, **scores: float) -> Outcome:
        usual = dict.fromkeys(UNITS, 0.0) | {"bound": np.nan, "jaccard": 99.0}
        return Outcome(name=name, scores=usual | scores, intervals={}, sequences={}, worst=None)

    ranked = sorted(
        [
            outcome("lossy", bound=1.0, lost=30.0, jaccard=70.0),
            outcome("coarse", bound=9.0, jaccard=99.9),
            outcome("invents", bound=1.0, false=6.0, jaccard=94.0),
            outcome("close", bound=1.2, lost=2.0, jaccard=98.0),
            outcome("unknown", jaccard=99.0),
        ],
        key=_rank,
    )
    assert [one.name for one in ranked] == ["close", "coarse", "unknown", "invents", "lossy"]


def test_tables_have_means_with_intervals_where_there_are_several() -> None:
    one, more, lost = (
        of_names(name, values)
        for name, values in {"a": [0.5], "b": [1.0, 3.0], "c": [1.0, np.nan]}.items()
    )
    assert one.intervals == {}
    assert "no interval" in interval_note([one])
    assert "no interval" not in interval_note([more])
    assert dict(line[:2] for line in score_table([one]).lines)["rms px"] == "0.5"
    assert dict(line[:2] for line in score_table([more]).lines)["rms px"] == "2 (1 … 3)"
    told = json.loads(json.dumps(as_json([one, more, lost], Path("truth"))))["tracks"]
    bounds = [entry["intervals"] for entry in told]
    assert bounds == [{}, {name: [1.0, 3.0] for name in UNITS}, dict.fromkeys(UNITS)]
    # Each case has its own mean.
    made = of_names("a", [1.0, 10.0, 3.0, 20.0])
    cases = dict(zip(made.sequences, ["easy", "hard", "easy", "hard"], strict=True))
    rms, _ = case_tables([replace(made, cases=cases)])
    assert rms.header == ("rms px", "a")
    assert rms.lines == (("easy", "2 (1 … 3)"), ("hard", "15 (10 … 20)"))
    assert case_tables([one, more]) == []


def test_an_error_beside_a_large_one_is_drawn_twice_and_told() -> None:
    """By the factor of the largest typical error, where it cannot be seen, and by its own."""
    truth = Truth(points=moving())
    picture, found = np.zeros((480, 640, 3), np.uint8), []
    for name, error in (("good", 0.01), ("bad", 0.5)):
        named = Named(name="s", truth=truth, tracks=None, pictures=[picture])
        away = Scored(scores={}, error=np.full((1, COUNT, 2), error), at=np.zeros((1, COUNT, 2)))
        found.append((of_names(name, [error]), [(named, away, 0)]))
    assert [_factor(frame) for _, (frame,) in found] == [300.0, 10.0]
    good, bad = (outcome.worst for outcome in _with_pictures(found))
    assert good.shape[1] == 2 * bad.shape[1]
    orange = np.abs(good.astype(int) - [240, 130, 0]).sum(axis=-1) < 30
    alike, own = (part.sum() for part in np.split(orange, 2, axis=1))
    assert own > 5 * alike
    named, scored, k = found[1][1][0]
    assert _captions(named, scored, k, "x1")[1] == "error: median 0.71 px, largest 0.71 px"
    lost = replace(scored, error=np.full_like(scored.error, np.nan))
    assert _captions(named, lost, k, "x1")[1] == "no marker was found"
