"""Every study of the table goes on after an interruption, and one's own appears by itself."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.__main__ import load
from chromagrip.errors import UserError
from chromagrip.measure import study as table
from chromagrip.measure.bench import force as bench_force
from chromagrip.measure.engine import FIGURES, UNFINISHED, key_of, measure, run_study
from chromagrip.measure.study import Asked, Entry, Results, Study, studies, study
from chromagrip.output.report import Report, reported

load()
VERBS = ("bench", "chart", "stability", "project")
ENTRIES = [entry for verb in VERBS for part in studies(verb).values() for entry in part]


def named(entry: Entry) -> str:
    return " ".join([entry.verb, entry.part, *entry.worlds])


@dataclass(frozen=True)
class Found:
    """A result with an array and values that are not finite."""

    number: float
    values: NDArray[np.float64]


def count(results: Results[object, Found]) -> Report:
    return Report(
        rows=tuple(reported(str(k), one.number, "") for k, (_, one) in enumerate(results))
    )


@pytest.mark.parametrize("entry", ENTRIES, ids=named)
def test_an_interrupted_study_goes_on(
    entry: Entry, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each setting of each study is measured once, whatever it is made of."""
    monkeypatch.setattr(bench_force, "gl_problem", lambda: None)  # a window takes seconds
    made = entry.make(Asked(quick=True, world=entry.worlds[0]))
    settings = [*made.settings, *made.timed]
    assert settings
    assert len(set(map(key_of, settings))) == len(settings)
    ran: list[str] = []

    def stub(setting: object) -> Found:
        if len(ran) == stop:
            raise KeyboardInterrupt
        ran.append(key_of(setting))
        return Found(len(ran), np.array([[len(ran), np.nan, np.inf]]))

    stubbed = replace(
        made,
        measure=stub,
        result=Found,
        report=count,
        more=lambda results: (),
        show=lambda results, out: (),
    )
    stop = len(settings) // 2
    with pytest.raises(KeyboardInterrupt):
        run_study(named(entry), stubbed, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {UNFINISHED}
    stop = -1
    report = run_study(named(entry), stubbed, tmp_path)
    assert sorted(ran) == sorted(map(key_of, settings))
    assert [row.value for row in report.rows] == list(range(1, len(settings) + 1))
    assert {path.name for path in tmp_path.iterdir()} == {FIGURES, "index.html"}
    assert all(isinstance(made.words(one), str) for one in settings)


def squares(settings: tuple[int, ...], **more: object) -> Study[int, Found]:
    return Study(
        settings=settings,
        measure=lambda k: Found(k * k, np.full((0, 2), np.nan)),
        result=Found,
        report=count,
        **more,  # type: ignore[arg-type]
    )


def test_results_ask_for_further_settings() -> None:
    """Until none is missing; settings that take times come last."""
    largest = squares((1,), more=lambda results: [results[-1][1].number + 1], timed=(100,))
    with pytest.raises(KeyboardInterrupt):  # 1, 2, 5, 26, …
        run_study("more", replace(largest, measure=stopping_at(26)))
    few = squares((1, 2), more=lambda results: [3] if len(results) < 3 else (), timed=(9,))
    assert [row.value for row in run_study("few", few).rows] == [1, 4, 9, 81]


def stopping_at(last: int) -> Callable[[int], Found]:
    def measure_one(k: int) -> Found:
        if k == last:
            raise KeyboardInterrupt
        return Found(k * k, np.zeros((0, 2)))

    return measure_one


def interrupted(tmp_path: Path) -> Path:
    with pytest.raises(KeyboardInterrupt):
        run_study("squares", replace(squares((1, 2, 3)), measure=stopping_at(3)), tmp_path)
    return tmp_path / UNFINISHED


def test_a_line_that_a_kill_cut_off_is_measured_again(tmp_path: Path) -> None:
    path = interrupted(tmp_path)
    whole = path.read_text(encoding="utf-8")
    path.write_text(whole[:-10], encoding="utf-8")
    ran: list[int] = []
    again = replace(squares((1, 2, 3)), measure=lambda k: ran.append(k) or Found(k, np.zeros(1)))
    report = run_study("squares", again, tmp_path)
    assert ran == [2, 3]
    assert report.rows[0].value == 1


def test_a_file_that_is_damaged_or_of_another_study_is_refused_and_kept(tmp_path: Path) -> None:
    path = interrupted(tmp_path)
    whole = path.read_text(encoding="utf-8")
    for old, new, said in (
        ("shape", "form", "line 2, is no result of squares; remove"),
        ("squares", "cubes", "holds an unfinished cubes, no squares"),
    ):
        path.write_text(whole.replace(old, new), encoding="utf-8")
        with pytest.raises(UserError, match=said):
            run_study("squares", squares((1, 2, 3)), tmp_path)
        assert path.read_text(encoding="utf-8") == whole.replace(old, new)


def test_a_study_of_ones_own_appears_by_itself(
    typed: Callable[..., CompletedProcess[str]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(table, "_ENTRIES", dict(table._ENTRIES))

    @study("bench", "cubes", method="tracker")
    def cubes(asked: Asked) -> Study[int, float]:
        """Cubes of some numbers."""
        return Study(
            settings=range(3),
            measure=lambda k: float(k**3),
            result=float,
            report=lambda results: Report(
                rows=tuple(reported(("cube", str(k)), value, "") for k, value in results)
            ),
        )

    text = typed("bench", "cubes", "--help").stdout
    assert "Cubes of some numbers." in text
    assert "--tracker" in text
    done = typed("bench", "cubes", "--json", "--workers", "1", "--out", "made")
    values = {row["name"]: row["value"] for row in json.loads(done.stdout)["rows"]}
    assert values == {"cube/0": 0, "cube/1": 1, "cube/2": 8}
    assert json.loads((tmp_path / "made" / FIGURES).read_text())["rows"]
    assert measure("bench", "cubes", workers=1).rows[-1].value == 8.0
