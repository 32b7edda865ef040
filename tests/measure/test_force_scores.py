"""Scores of force estimates: errors that are put in come out, and rows say what is asked."""

from typing import ClassVar

import numpy as np
import pytest

from chromagrip.measure.bench import force as bench_force
from chromagrip.measure.bench import force_beyond, force_sets
from chromagrip.measure.engine import measure
from chromagrip.measure.study import Asked
from chromagrip.measure.worlds.beyond.scores import UNITS as BEYOND_UNITS
from chromagrip.measure.worlds.beyond.scores import beyond_scores
from chromagrip.measure.worlds.force_scenes import ForceScene
from chromagrip.measure.worlds.force_scores import (
    QUANTITIES,
    UNITS,
    Answers,
    answers,
    constant,
    scores,
    truth,
)
from chromagrip.measure.worlds.grasps import LIBRARY, scenes
from chromagrip.model import ForceField
from chromagrip.tracking import Z90, NoEstimateError, Tracks

#: (ΣFn, ΣFf, µ, Γ) of as many scenes, and the deviations of normal errors.
COUNT = 2000
TRUE = np.linspace([0.5, 0.1, 0.5, 0.05], [6.0, 1.0, 0.5, 0.84], COUNT)
DEVIATION = np.array([0.05, 0.01, 0.04, 0.06])
NOBODY, SOME = np.zeros(COUNT, dtype=bool), np.arange(COUNT) < COUNT / 4


def said(share: float = 1.0, flagged: np.ndarray = NOBODY) -> Answers:
    """Normal errors whose intervals are a share of what they should be."""
    value = TRUE + DEVIATION * np.random.default_rng(0).standard_normal(TRUE.shape)
    half = share * Z90 * DEVIATION
    interval = np.stack([value - half, value + half], axis=-1)
    return Answers(value=value, interval=interval, flagged=flagged)


def sure(value: np.ndarray, flagged: np.ndarray = NOBODY) -> Answers:
    """Answers with intervals of no width."""
    return Answers(value=value, interval=np.stack([value] * 2, axis=-1), flagged=flagged)


def test_errors_as_large_as_the_limit_score_one_and_their_intervals_hold() -> None:
    found = scores(said(), TRUE, np.broadcast_to(DEVIATION, TRUE.shape))
    assert set(found) == set(UNITS)
    for quantity in QUANTITIES:
        assert found[f"{quantity}_limit"] == pytest.approx(1.0, abs=0.1)
        assert found[f"{quantity}_coverage"] == pytest.approx(90.0, abs=3.0)
        assert found[f"{quantity}_width"] == pytest.approx(Z90, rel=0.1)
    assert found["friction_rms"] == pytest.approx(0.01, rel=0.1)
    relative = 5.0 * np.sqrt((TRUE[:, 0] ** -2.0).mean())
    assert found["normal_rms"] == pytest.approx(relative, rel=0.15)
    assert found["mu_rms"] == pytest.approx(0.04, rel=0.1)
    assert abs(found["mu_bias"]) < 0.003
    assert found["margin_near_rms"] == pytest.approx(0.06, rel=0.1)
    assert found["far_off"] == found["flagged"] == 0.0


def test_a_perfect_answer_scores_nothing_and_a_constant_its_scatter() -> None:
    perfect = scores(sure(TRUE), TRUE)
    of_errors = ("normal_rms", "friction_rms", "mu_rms", "margin_rms", "margin_near_rms", "far_off")
    assert [perfect[score] for score in of_errors] == [0.0] * 6
    assert perfect["normal_coverage"] == 100.0
    found = scores(constant(TRUE), TRUE)
    assert found["margin_rms"] == pytest.approx(TRUE[:, 3].std())
    assert found["friction_rms"] == pytest.approx(TRUE[:, 1].std())
    assert found["far_off"] > 20.0
    # Where µ is the same in all scenes, a constant knows it: that is what its row is for.
    assert found["mu_rms"] == 0.0


def test_flagged_frames_count_as_what_a_controller_is_told() -> None:
    value, n = TRUE.copy(), COUNT // 40
    value[SOME] = [0.0, 0.0, 0.0, 1.0]
    value[10 * n : 11 * n, 0] *= 1.6
    found = scores(sure(value, SOME), TRUE)
    assert (found["flagged"], found["far_off"]) == (25.0, 2.5)
    squares = 10 * n * 1.0 + n * 0.6**2
    assert found["normal_rms"] == pytest.approx(100 * np.sqrt(squares / COUNT))
    assert found["normal_coverage"] == pytest.approx(100 * 29 / 30)


def test_mu_is_asked_for_only_where_it_can_be_seen() -> None:
    true = TRUE.copy()
    true[SOME, 3] = 0.9
    value = true.copy()
    value[SOME, 2] = 5.0
    found = scores(sure(value), true)
    assert (found["mu_rms"], found["far_off"], found["mu_coverage"]) == (0.0, 0.0, 100.0)
    nowhere = TRUE * [1.0, 1.0, 1.0, 0.0] + [0.0, 0.0, 0.0, 0.9]
    assert np.isnan(beyond_scores(said(), nowhere)["mu_honest"])


def test_right_intervals_are_honest_and_half_as_wide_ones_are_not() -> None:
    right, narrow = beyond_scores(said(), TRUE), beyond_scores(said(share=0.5), TRUE)
    assert set(right) == set(BEYOND_UNITS)
    assert right["honest"] == pytest.approx(90.0, abs=1.5)
    # |z| > 3.29 in any of four: 4 × 0.1 %; |z| > 1.645: 1 − 0.9⁴.
    assert right["narrow"] == pytest.approx(0.4, abs=0.3)
    assert narrow["narrow"] == pytest.approx(34.4, abs=2.5)
    # |z| < 0.822 in 58.9 %.
    assert narrow["margin_honest"] == pytest.approx(58.9, abs=2.5)
    assert right["mu_width"] == pytest.approx(Z90, rel=0.05)
    assert narrow["margin_width"] == pytest.approx(Z90 / 2, rel=0.05)
    assert right["margin_error"] == pytest.approx(0.06, rel=0.05)
    assert right["flagged"] == narrow["flagged"] == 0.0


def test_flagged_frames_are_honest_and_no_error_is_counted_of_them() -> None:
    estimate = said(flagged=SOME)
    estimate.value[SOME] = 9.0
    found = beyond_scores(estimate, TRUE)
    assert found["flagged"] == 25.0
    assert found["honest"] == pytest.approx(25.0 + 0.75 * 90.0, abs=1.5)
    assert found["margin_coverage"] == pytest.approx(90.0, abs=1.5)
    assert found["margin_error"] == pytest.approx(0.06, rel=0.05)
    # An interval without an end is a flag, and none at all is too narrow.
    endless, missing = said(), said()
    endless.interval[SOME, 3] = [-np.inf, np.inf]
    missing.interval[SOME, 3] = np.nan
    assert beyond_scores(endless, TRUE)["flagged"] == 25.0
    found = beyond_scores(missing, TRUE)
    assert (found["flagged"], found["margin_narrow"]) == (0.0, pytest.approx(25.0, abs=0.3))


# ---- from tracks to rows ----


class Told:
    """Reconstructor that is told the truth."""

    FIELD: ClassVar[ForceField]

    def __init__(self, calibration: object, rest: Tracks) -> None: ...

    def reset(self) -> None: ...

    def update(self, tracks: Tracks) -> ForceField:
        return self.FIELD


class Refusing(Told):
    """Reconstructor that sees nothing."""

    def update(self, tracks: Tracks) -> ForceField:
        raise NoEstimateError("nothing to be seen")


INDEX = 5  # of a grasp that the tracker follows quickly


@pytest.fixture(scope="module")
def scene() -> ForceScene:
    (made,) = scenes("matched", LIBRARY, INDEX)
    Told.FIELD = made.field
    return made


def test_a_scene_is_in_range_in_its_cone_and_balanced(scene: ForceScene) -> None:
    normal, _, mu, margin = truth(scene)
    assert 0.4 <= normal <= 6.0
    assert 0.05 + 0.1 * INDEX <= margin <= 0.15 + 0.1 * INDEX  # its own bin
    assert (abs(scene.field.friction) <= mu * scene.field.normal + 1e-12).all()
    times = [tracks.time for tracks in scene.tracks]
    np.testing.assert_allclose(np.diff(times), 0.01)
    assert times[-1] == pytest.approx(1.5)
    assert all(tracks.visible.mean() > 0.97 for tracks in scene.tracks)
    assert not np.array_equal(scene.tracks[0].position, scene.tracks[1].position)


def test_rows_have_stable_names_and_targets_are_asked_of_the_best_alone(
    scene: ForceScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    told, refusing = (answers("it", one, scene)["0.1s"]["it"] for one in (Told, Refusing))
    np.testing.assert_allclose(told.value[0, :2], truth(scene)[:2])
    assert (told.flagged[0], refusing.flagged[0]) == (False, True)
    np.testing.assert_array_equal(refusing.value[0], [0.0, 0.0, 0.0, 1.0])
    assert np.isnan(refusing.interval).all()
    best, refuses = (f"{__name__}:{reader.__name__}" for reader in (Told, Refusing))
    monkeypatch.setattr(bench_force, "QUICK", {("matched", LIBRARY): 1})
    monkeypatch.setattr(bench_force, "_QUICK_LIMITED", 0)
    monkeypatch.setattr(bench_force, "gl_problem", lambda: None)
    monkeypatch.setattr(bench_force, "BEST", dict.fromkeys(("single", "0.1s"), best))
    monkeypatch.setattr(bench_force, "scenes", lambda *_, **__: [scene])
    monkeypatch.setattr(force_sets, "scenes", lambda *_, **__: [scene])
    monkeypatch.setattr(bench_force, "beyond_counts", lambda *_: {})
    report = measure("bench", "force", Asked(quick=True, methods=(best, refuses)), workers=1)
    found = {row.name: row for row in report.rows}
    row = found[f"matched/single/{best}/normal_rms"]
    assert (row.value, str(row.target)) == (pytest.approx(0.0, abs=1e-9), "0…5")
    row = found[f"matched/0.1s/{refuses}/normal_rms"]
    assert (row.value, row.target, row.met) == (pytest.approx(100.0), None, None)
    assert found[f"matched/single/{refuses}/flagged"].value == 100.0
    assert found["matched/single/constant/margin_rms"].value == pytest.approx(0.0)
    assert str(found[f"speed/{best}"].target) == "≥ 300"
    assert found["speed/cheapest"].met
    table, readings = report.tables
    names = [line[0] for line in table.lines[:3]]
    assert names == [f"{name}, single" for name in ("constant", best, refuses)]
    (line,) = readings.lines
    error = found[f"matched/single/{best}+max-ratio/mu_bias"].value or 0.0
    assert error < 0.0  # a ratio of true forces is never above µ
    assert line[readings.header.index("max-ratio")] == f"{abs(error):.3f} ({error:+.3f}) / –"
    single = report.details[0]
    assert single.header == ("score", "constant", best, refuses)
    assert {line[0].split(" ")[0] for line in single.lines} == {
        score for score in UNITS if not score.endswith("_limit")
    }


def test_rows_of_groups_and_parts_mark_what_a_constant_passes() -> None:
    results = force_sets.Measured(
        true=TRUE,
        answers={read: {"sequential": said(share=0.5)} for read in ("single", "0.1s")},
        limit={},
        labels=tuple(("left" if k % 2 else "right", "all") for k in range(COUNT)),
    )
    methods = {"sequential": "sequential"}
    made = force_beyond.beyond_rows({"beyond/roll": results}, methods, "sequential")
    rows = {row.name.removeprefix("beyond/roll/"): row for row in made}
    honest, error = (rows[f"0.1s/sequential/{score}"] for score in ("honest", "margin_error"))
    assert (honest.met, str(honest.target)) == (False, "≥ 90")
    assert honest.note == "a constant answer passes"
    assert (error.met, error.note) == (True, "")  # the scatter of Γ is 0.23
    assert rows["single/sequential/honest"].target is None
    guess = beyond_scores(constant(TRUE), TRUE)["honest"]
    assert rows["0.1s/constant/honest"].value == pytest.approx(guess)
    assert rows["left/0.1s/sequential/scenes"].value == COUNT / 2
    assert rows["all/0.1s/sequential/honest"].value == honest.value
