"""What is kept of a run that lasts: exact counts, and rows at even intervals."""

import numpy as np
import pytest

from chromagrip.output.parquet import Row
from chromagrip.pictures.kept_rows import KeptRows, Thinned


@pytest.mark.parametrize("count", [0, 1, 8, 9, 16, 17, 1000])
def test_values_are_kept_at_even_intervals(count: int) -> None:
    thinned = Thinned[int](8)
    for value in range(count):
        thinned.add(value)
    kept = thinned.kept
    assert len(kept) <= 8
    step = kept[1] - kept[0] if len(kept) > 1 else 1
    assert kept == list(range(0, count, step))  # also the last one that belongs to them
    assert count <= 8 or len(kept) > 4
    assert count > 8 or step == 1


def row_of(index: int) -> Row:
    """A row; every third frame has no estimate, and the last ten have none."""
    silent = index % 3 == 0 or index >= 990
    row: Row = {"frame": index, "no_estimate": f"only {index} markers" if silent else ""}
    if not silent:
        row |= {"normal_n": float(index), "mu_observable": index % 2 == 0}
    return row | {"node_n": np.zeros(100)}


def test_counts_are_exact_and_memory_is_bounded() -> None:
    kept = KeptRows(period=0.01, most=50)
    late = np.random.default_rng(3).uniform(0.0, 0.02, 1000)
    late[777] = 0.5  # of a frame whose row is not kept
    for index in range(1000):
        kept.add(row_of(index), late[index])
    rows = [row_of(index) for index in range(1000)]
    assert kept.without == sum(bool(row["no_estimate"]) for row in rows)
    assert kept.because == {"only 0 markers": kept.without}
    assert kept.observable == sum(bool(row.get("mu_observable")) for row in rows)
    assert len(kept.rows) <= 52
    frames = [row["frame"] for row in kept.rows]
    assert frames == sorted(frames)
    assert {989, 999} <= {*frames}  # the last one with an estimate, and the last one
    assert all("node_n" not in row for row in kept.rows)
    found = kept.late
    assert found["late_frames"] == (late > 0.01).sum()
    assert found["reading_ms"] is not None
    assert found["reading_ms"]["worst"] == pytest.approx(500.0)
    assert found["reading_ms"]["median"] == pytest.approx(10.0, abs=4.0)


def test_a_run_that_is_short_is_kept_whole() -> None:
    kept = KeptRows(period=0.01)
    assert kept.rows == []
    assert kept.late == {"reading_ms": None, "late_frames": None}
    for index in range(30):
        kept.add(row_of(index), 0.001)
    assert [row["frame"] for row in kept.rows] == list(range(30))
