"""Scores of anybody's tracks, against truths that are known in closed form."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
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


def test_a_constant_answer_is_bad() -> None:
    true = moving()
    constant = replace(true, position=np.repeat(true.position[:1], FRAMES, axis=0))
    scores = score(constant, Truth(points=true)).scores
    assert scores["p95"] > 5.0
    assert scores["jaccard"] < 80.0


def test_points_of_another_scene_are_refused() -> None:
    with pytest.raises(UserError, match="none of the tracked points is where"):
        score(off(moving(), [500.0, 0.0]), Truth(points=moving()))


def table(points: Points, words: tuple[str, ...] = WORDS) -> pd.DataFrame:
    frame, point = np.divmod(np.arange(points.visible.size), len(points.names))
    numbers = np.array([number for _, number in points.names])[point]
    columns = (frame, numbers, *points.position.reshape(-1, 2).T)
    return pd.DataFrame(dict(zip(words, columns, strict=True)))


def write_csv(path: Path, points: Points, words: tuple[str, ...] = WORDS) -> Path:
    table(points, words)[points.visible.ravel()].to_csv(path, index=False)
    return path


def write_parquet(path: Path, points: Points) -> Path:
    table(points).assign(visible=points.visible.ravel()).to_parquet(path)
    return path


def write_tap(path: Path, points: Points) -> Path:
    tracks = np.nan_to_num(np.swapaxes(points.position, 0, 1))
    np.savez(path, tracks=tracks, visibles=points.visible.T)
    return path


def test_every_format_says_the_same(tmp_path: Path) -> None:
    visible = np.random.default_rng(5).random((FRAMES, COUNT)) > 0.1
    points = seen(moving(), visible)
    files = [
        write_csv(tmp_path / "a.csv", points, ("frame", "track", "x", "y")),
        write_csv(tmp_path / "b.csv", points),
        write_parquet(tmp_path / "c.parquet", points),
        write_tap(tmp_path / "d.npz", points),
    ]
    for file in files:
        found = read_points(file)
        assert (found.visible == points.visible).all()
        np.testing.assert_allclose(found.position, points.position)


@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["plain", "bom"])
@pytest.mark.parametrize("case", [str, str.upper, str.title])
def test_tables_of_other_programs_are_read(
    tmp_path: Path, mark: str, case: Callable[[str], str]
) -> None:
    """With trackpy's columns and index, and TrackMate's with three more rows of names and units."""
    points = seen(moving(), np.random.default_rng(8).random((FRAMES, COUNT)) > 0.1)
    rows = [
        (k, number, *points.position[k, number])
        for k, number in np.argwhere(points.visible).tolist()
    ]
    trackpy = [",".join(map(case, ("", "y", "x", "mass", "frame", "particle")))]
    trackpy += [f"{i},{y},{x},41.5,{k},{n}.0" for i, (k, n, x, y) in enumerate(rows)]
    trackmate = [
        ",".join(map(case, ("label", "id", "track_id", "position_x", "position_y", "frame"))),
        "Label,Spot ID,Track ID,X,Y,Frame",
        "Label,Spot ID,Track ID,X,Y,Frame",
        ",,,(pixel),(pixel),",
    ]
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


def counted_from(points: Points, first: int) -> Points:
    """The same points with frames of larger numbers."""
    return Points(
        names=points.names,
        position=np.concatenate([np.full((first, COUNT, 2), np.nan), points.position]),
        visible=np.concatenate([np.zeros((first, COUNT), dtype=bool), points.visible]),
    )


def test_frames_that_are_all_shifted_by_one_are_named() -> None:
    true = moving()
    noise = 0.05 * np.random.default_rng(9).standard_normal(true.position.shape)
    mine = off(true, noise)
    still = replace(true, position=np.repeat(true.position[:1], FRAMES, axis=0))
    lossy = seen(mine, np.random.default_rng(10).random((FRAMES, COUNT)) > 0.5)
    for tracked, truth, told in (
        (counted_from(lossy, 1), true, "counted from one less, "),
        (counted_from(still, 1), still, "counted from one less"),
        (off(true, -2.0), true, "counted from one less"),  # a frame late
        (lossy, true, None),
        (still, true, None),
        (still, still, None),
        (replace(mine, names=[("", k + 1) for k in range(COUNT)]), true, None),  # any numbers
    ):
        doubt = score(tracked, Truth(points=truth)).doubt
        assert (told in doubt) if told else not doubt, (told, doubt)


def test_shifted_frames_are_said_at_the_terminal_and_in_the_files(
    tmp_path: Path, typed: Typed
) -> None:
    truth = write_csv(tmp_path / "truth.csv", moving())
    mine = write_csv(tmp_path / "mine.csv", counted_from(moving(), 1))
    out = tmp_path / "out"
    told = "mine, truth.csv: the frames seem to be shifted by one"
    assert told in typed("score", mine, truth, "--out", out).stdout
    assert told in (out / "leaderboard.html").read_text(encoding="utf-8")
    (found,) = json.loads((out / "scores.json").read_text(encoding="utf-8"))["tracks"]
    assert "counted from one less" in found["doubts"]["truth.csv"]


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("a.txt", "", "expected a file that ends in .parquet, .csv, .npz"),
        ("a.csv", "frame,x,y\n0,1,2\n", "has no column marker or point or particle or"),
        ("a.csv", "frame;marker;x;y\n0;1;2;3\n", "separated by semicolons; expected commas"),
        ("a.csv", "frame,id,x,y\n", "has no row"),
        ("a.csv", "frame,id,x,y\n0,1,2,2\n0,2,far,2\n", "a.csv: row 2, column x: 'far' is no num"),
        ("a.csv", "frame,id,x,y\n0,1.5,2,2\n", "row 1, column id: '1.5' is no whole number"),
        ("a.csv", "frame,id,x,y,visible\n0,1,2,2,perhaps\n", "'perhaps' is no true or false"),
        ("a.csv", "frame,id,x,y\n0,1,2\n", "row 1 has not 4 values"),
        ("a.csv", "frame,id,x,y\n3,1,2,2\n3,1,2,2\n", "1 rows repeat another one, first of marker"),
        ("a.csv", "frame,id,x,y\n-1,1,2,2\n", "a frame before 0"),
        ("a.parquet", "nothing", "cannot be read"),
        ("a.npz", "nothing", "cannot be read"),
        ("none.csv", None, "cannot be read: No such file"),
    ],
)
def test_what_are_no_tracks_is_refused(
    tmp_path: Path, name: str, text: str | None, told: str
) -> None:
    path = tmp_path / name
    if text is not None:
        path.write_text(text, encoding="utf-8")
    for kind in ("tracks", "truth"):
        with pytest.raises(UserError, match=re.escape(told)) as refused:
            read_points(path, kind)
        assert str(refused.value).startswith(f"{kind} {path}: ")
        assert str(refused.value).count(str(path)) == 1


def layered(points: Points, names: tuple[str, ...]) -> Points:
    """The same points once for each layer, as markers that lie on each other."""
    return Points(
        names=[(name, k) for name in names for _, k in points.names],
        position=np.concatenate([points.position] * len(names), axis=1),
        visible=np.concatenate([points.visible] * len(names), axis=1),
    )


def test_layers_that_are_not_told_are_asked_for() -> None:
    """Points of one place cannot be given to layers by chance: half of them would be lost."""
    truth = Truth(points=layered(moving(), ("magenta", "yellow")))
    for found, words in ((moving(), "no layer"), (layered(moving(), ("a", "b")), "layer a and b")):
        with pytest.raises(UserError, match=rf"have (the )?{words}.* magenta and yellow"):
            score(found, truth)
    assert score(layered(moving(), ("magenta",)), truth).scores["lost"] == 50.0
    assert score(truth.points, truth).scores["lost"] == 0.0


def test_arrays_may_name_their_layers(tmp_path: Path) -> None:
    points = layered(moving(), ("magenta", "yellow"))
    tracks, visibles = np.swapaxes(points.position, 0, 1), points.visible.T
    np.savez(tmp_path / "a.npz", tracks=tracks, visibles=visibles, layer=points.layers.astype(str))
    assert (read_points(tmp_path / "a.npz").layers == points.layers).all()
    np.savez(tmp_path / "b.npz", tracks=tracks, visibles=visibles, layer=["magenta"])
    with pytest.raises(UserError, match=r"b.npz: its array layer names 1 of 60 points"):
        read_points(tmp_path / "b.npz")


@pytest.mark.studies
def test_the_command_ranks_trackers_on_a_dataset(tmp_path: Path, typed: Typed) -> None:
    """Our own tracker near the bound, beside one that says that nothing moves."""
    data = tmp_path / "data"
    assert typed("dataset", "make", "tiny", "--n", 2, "--out", data).returncode == 0
    sequence = data / "sequence-000000"
    for tracker in ("fit", "lk"):
        words = ("track", sequence / "rest.png", sequence, "--palette", "thesis")
        out = tmp_path / tracker
        assert typed(*words, "--tracker", tracker, "--out", out).returncode == 0
        (out / "tracks.parquet").rename(tmp_path / f"{tracker}.parquet")
    files = [tmp_path / "lk.parquet", tmp_path / "fit.parquet"]
    out = tmp_path / "scores"
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
    assert {file.name for file in out.iterdir()} == {
        "scores.json", "leaderboard.html", "worst-fit.png", "worst-lk.png",
    }  # fmt: skip
    # A tracker of one's own by its name, which has characters that a file's may not have.
    (tmp_path / "still.py").write_text(
        "from chromagrip.tracking.baselines.flow import LucasKanade as Still\n"
    )
    assert typed("score", "still:Still", sequence, "--out", "own-scores").returncode == 0
    assert (tmp_path / "own-scores" / "worst-still-Still.png").is_file()
    # Which of two sequences is not guessed, and none is left out in silence.
    own = tmp_path / "own"
    own.mkdir()
    (tmp_path / "fit.parquet").rename(own / "tracks.parquet")
    assert typed("score", own, sequence, "--out", out, "--overwrite").returncode == 0
    for tracks, told_ in ((files[0], "has 2 sequences; give the one"), (own, "2 of 2 sequences")):
        done = typed("score", tracks, data, "--out", tmp_path / "none")
        assert (done.returncode, told_ in done.stderr) == (2, True), done.stderr
        assert not (tmp_path / "none").exists()


def test_a_truth_that_is_none_is_one_sentence(tmp_path: Path, typed: Typed) -> None:
    file = write_parquet(tmp_path / "a.parquet", moving())
    for words, told in (
        ((file,), "score needs tracks and a truth"),
        ((file, "nowhere"), "there is no truth nowhere"),
        ((file, tmp_path), "is no dataset"),
    ):
        done = typed("score", *words)
        assert (done.returncode, told in done.stderr) == (2, True), done.stderr
        assert len(done.stderr.splitlines()) == 1


def test_intervals_are_those_of_means_of_many_sequences() -> None:
    """By the central limit theorem: mean ± 1.645 σ/√n."""
    values = np.random.default_rng(3).exponential(2.0, 400)
    low, high = intervals([{"rms": value} for value in values])["rms"]
    half = 1.645 * values.std() / np.sqrt(len(values))
    assert (low + high) / 2.0 == pytest.approx(values.mean(), abs=0.15 * half)
    assert (high - low) / 2.0 == pytest.approx(half, rel=0.1)


def test_intervals_hold_the_true_mean_as_often_as_they_say() -> None:
    """Of 30 sequences a bootstrap of percentiles covers slightly less than its 90 %."""
    rng = np.random.default_rng(4)
    inside = 0
    for _ in range(300):
        low, high = intervals([{"rms": value} for value in rng.normal(1.0, 0.5, 30)])["rms"]
        inside += low < 1.0 < high
    assert 0.84 < inside / 300 < 0.94


def test_intervals_judge_two_makers_on_the_same_draws() -> None:
    """What is better by the same amount in every sequence is better at both bounds."""
    values = np.random.default_rng(5).exponential(1.0, 12)
    scores = [{"rms": value, "p95": value + 0.25, "bound": 3.0} for value in values]
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


def test_each_case_has_its_own_mean() -> None:
    made = of_names("a", [1.0, 10.0, 3.0, 20.0])
    names = list(made.sequences)
    cases = dict(zip(names, ["easy", "hard", "easy", "hard"], strict=True))
    rms, lost = case_tables([replace(made, cases=cases)])
    assert rms.header == ("rms px", "a")
    assert rms.lines == (("easy", "2 (1 … 3)"), ("hard", "15 (10 … 20)"))
    assert lost.lines == rms.lines
    (alone, _) = case_tables([replace(made, cases={names[1]: "hard"})])
    assert alone.lines == (("hard", "10"),)


def test_one_sequence_has_no_interval_and_it_is_said() -> None:
    one, more, lost = (
        of_names(name, values)
        for name, values in {"a": [0.5], "b": [1.0, 3.0], "c": [1.0, np.nan]}.items()
    )
    assert one.intervals == {}
    assert "no interval" in interval_note([one])
    assert "no interval" not in interval_note([more])
    assert {line[0]: line[1] for line in score_table([one]).lines}["rms px"] == "0.5"
    assert case_tables([one, more]) == []
    # Of two sequences the means are 1, 2 and 3.
    assert {line[0]: line[1] for line in score_table([more]).lines}["rms px"] == "2 (1 … 3)"
    told = json.loads(json.dumps(as_json([one, more, lost], Path("truth"))))["tracks"]
    assert [entry["intervals"] for entry in told] == [
        {}, {name: [1.0, 3.0] for name in UNITS}, dict.fromkeys(UNITS),
    ]  # fmt: skip


def test_an_error_beside_a_large_one_is_drawn_twice_and_told() -> None:
    """By the factor of the largest typical error, where it cannot be seen, and by its own."""
    truth = Truth(points=moving())
    count = truth.points.visible.shape[1]
    picture = np.zeros((480, 640, 3), np.uint8)
    found = []
    for name, error in (("good", 0.01), ("bad", 0.5)):
        named = Named(name="s", truth=truth, tracks=None, pictures=[picture])
        away = Scored(scores={}, error=np.full((1, count, 2), error), at=np.zeros((1, count, 2)))
        found.append((of_names(name, [error]), [(named, away, 0)]))
    assert [_factor(frame) for _, (frame,) in found] == [300.0, 10.0]
    good, bad = (outcome.worst for outcome in _with_pictures(found))
    assert good is not None
    assert bad is not None
    assert good.shape[1] == 2 * bad.shape[1]
    orange = [
        int((np.abs(part.astype(int) - [240, 130, 0]).sum(axis=-1) < 30).sum())
        for part in np.split(good, 2, axis=1)
    ]
    assert orange[1] > 5 * orange[0]
    named, scored, k = found[1][1][0]
    told = _captions(named, scored, k, "x10 (all tracks alike)")
    assert told[1] == "error: median 0.71 px, largest 0.71 px"
    assert told[2].endswith("x10 (all tracks alike)")
    lost = replace(scored, error=np.full_like(scored.error, np.nan))
    assert _captions(named, lost, k, "x1")[1] == "no marker was found"
