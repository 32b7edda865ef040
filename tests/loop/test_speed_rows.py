"""The figures of the environments are measured; how fast is not asked here."""

import pytest

from benchmarks.environments import environment_rows


@pytest.mark.loops
def test_every_observation_has_a_figure() -> None:
    rows = list(environment_rows(duration_s=0.05, turns=1))
    names = [
        "speed/environment/margin",
        "speed/environment/forces",
        "speed/environment/image",
        "speed/environment/markers",
        "speed/pinch/forces",
        "speed/pinch/image",
    ]
    assert [row.name for row in rows] == [
        *(each for name in names for each in (name, f"{name}/cpu")),
        "speed/outside/median",
        "speed/outside/p95",
    ]
    assert all(row.value is not None and row.value > 0.0 for row in rows)
    assert {row.name: str(row.target) for row in rows if "≥" in str(row.target)} == {
        "speed/environment/margin": "≥ 1000",
        "speed/environment/forces": "≥ 1000",
        "speed/pinch/forces": "≥ 75",
        "speed/pinch/image": "≥ 30",
    }
