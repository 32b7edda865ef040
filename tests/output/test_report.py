"""Rows and reports: verdicts, names, and what is printed of them."""

import json
import math

import pytest

from chromagrip.output.report import (
    Bounds,
    Report,
    Row,
    Table,
    at_least,
    at_most,
    measured,
    print_report,
    report_markdown,
    reported,
    score_table,
    values,
    within,
)

ROWS = (
    within(("jerk-1", "camera", "gross"), 2.0, "runs", 0.0, 1.0),
    at_least(("speed", "fit"), 250.0, "frames/s", 200.0),
    reported(("jerk-1", "camera", "energy"), 0.5, "N²/s"),
    within(("long", "fit", "drift"), None, "", 0.9, 1.1, note="it refused the frames"),
)


def test_only_a_row_with_a_target_has_a_verdict() -> None:
    assert [row.met for row in ROWS] == [False, True, None, False]
    assert [str(row.target) for row in ROWS] == ["0…1", "≥ 200", "None", "0.9…1.1"]
    assert str(at_most("x", 1.0, "", 2.0).target) == "≤ 2"
    assert str(within("x", 1.0, "", 5, 5).target) == "5"
    assert within("x", 5.0, "", 5, 5).met
    assert at_least("x", 1.0, "", -math.inf).target is None
    assert at_most("x", 1.0, "", math.inf).met is None
    for value in (math.nan, math.inf, None):  # not measured
        row = measured("x", value, "", Bounds(0.0))
        assert (row.value, row.met) == (None, False)


def test_json_keeps_its_keys_and_names() -> None:
    entries = json.loads(json.dumps(Report(rows=ROWS).as_json(), allow_nan=False))["rows"]
    wanted = {"name": "jerk-1/camera/gross", "value": 2.0, "unit": "runs", "target": "0…1"}
    assert entries[0] == wanted | {"met": False}
    assert (entries[2]["target"], entries[2]["met"]) == (None, None)
    assert values(ROWS)["speed", "fit"] == 250.0
    assert (ROWS[0].subject, ROWS[0].score) == (("jerk-1", "camera"), "gross")
    assert Row(("a", "b"), "c", 1.0).name == "a/b/c"


def test_a_table_of_scores_has_a_column_for_each_case() -> None:
    rows = [
        reported(("clean", "my/module:Mine", "lost"), 3.0, ""),
        reported(("clean", "my/module:Mine", "time"), 12.345, "ms"),
        reported(("clean", "fit", "time"), None, "ms"),
    ]
    table = score_table(rows, lambda row: row.subject[1])
    assert table.header == ("score", "my/module:Mine", "fit")
    assert table.lines == (("lost", "3", "–"), ("time [ms]", "12.3", "–"))


def test_figures_without_a_target_are_left_to_the_tables(capsys: pytest.CaptureFixture) -> None:
    table = Table(("scene", "fit"), (("sway", "1.02"),), title="Errors")
    report = Report(rows=ROWS, tables=(table,), notes=("A sentence.",), details=(table,))
    assert [line[0] for line in report.listed().lines] == [ROWS[k].name for k in (0, 1, 3)]
    assert len(Report(rows=ROWS).listed().lines) == len(ROWS)
    print_report(report)
    screen = capsys.readouterr().out
    assert screen.count("Errors") == screen.count("A sentence.") == 1
    assert "energy" not in screen
    assert "it refused the frames" in screen
    page = "\n".join(report_markdown(report))
    assert page.count("Errors:\n\n| scene | fit |\n| --- | --- |\n| sway | 1.02 |") == 1
    assert "1 of 3 targets are met; the others:" in page
    assert "it refused the frames" in page
    assert "speed/fit" not in page
