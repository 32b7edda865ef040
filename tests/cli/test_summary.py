"""The summary of a run on the screen."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from chromagrip.cli.summary import print_summary

WRITTEN = Path(__file__).parents[2] / "fixtures" / "written-before"
#: What frames from outside do not show.
UNKNOWN = ("final_turn_deg", "gross_slip", "lateral_displacement_mm", "final_margin_true")


@pytest.mark.parametrize(("body", "torsion"), [("chain", False), ("dome", True)])
def test_frames_from_outside_have_the_rows_of_their_body(
    body: str, torsion: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = json.loads((WRITTEN / body / "summary.json").read_text("utf-8"))
    summary |= dict.fromkeys(UNKNOWN) | {"sensor": "dome-2020"}
    scene = SimpleNamespace(target_margin=None, grip_ceiling=None, sensor=summary["sensor"])
    print_summary(cast("Any", SimpleNamespace(summary=summary, folder=None, scene=scene)), "theirs")
    printed = capsys.readouterr().out
    assert ("the same with torsion" in printed) == torsion
    assert ("those of the chain" in printed) == (not torsion)
