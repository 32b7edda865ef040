"""The comparison of commits finds what differs, and nothing else."""

import json
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest


def fill(folder: Path, time: float, rows: str, level: int) -> Path:
    folder.mkdir(parents=True)
    table = {"time_s": [0.0, time], "margin": [0.5, float("nan")], "nodes": [[1, 2], [3]]}
    pq.write_table(pa.table(table), folder / "trace.parquet")
    (folder / "map.csv").write_text(f"gain,letter\n1.5,a\n{rows}\n")
    speed = {"name": "camera/rate", "value": time, "unit": "frames/s"}  # of the clock
    report = {"machine": {"cores": level}, "rows": [speed]}
    (folder / "report.json").write_text(json.dumps(report))
    cv2.imwrite(str(folder / "figure.png"), np.full((4, 4, 3), level, np.uint8))
    return folder


def test_every_difference_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    from compared.computing import Result  # type: ignore[import-not-found]
    from compared.differences import differences  # type: ignore[import-not-found]
    from compared.digests import digests  # type: ignore[import-not-found]

    old = fill(tmp_path / "old/job", 0.1, "2.5,b", 7)
    new = fill(tmp_path / "new/job", 0.125, "2.75,b", 9)
    (new / "more.toml").touch()
    one, other = (Result(each, [], 0.0, files=digests(each)) for each in (old, new))
    assert [str(each) for each in differences(one, one)] == []
    assert sorted(str(each) for each in differences(one, other)) == [
        "changed  job: figure.png: bytes",
        "changed  job: figure.png: pixels: up to 2",
        "changed  job: map.csv: gain: up to 0.25",
        "changed  job: trace.parquet: time_s: up to 0.025",
        "new      job: more.toml",
    ]
