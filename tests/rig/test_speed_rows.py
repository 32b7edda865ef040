"""The figures of the environments are measured; how fast is not asked here."""

from chromagrip.measure.environments import environment_rows


def test_every_observation_has_a_figure() -> None:
    rows = list(environment_rows(lambda text: None, duration_s=0.05, turns=1))
    assert [row.name for row in rows] == [
        "speed/environment/margin",
        "speed/environment/forces",
        "speed/environment/image",
        "speed/environment/markers",
        "speed/outside/median",
        "speed/outside/p95",
    ]
    assert all(row.value is not None and row.value > 0.0 for row in rows)
    assert [str(row.target) for row in rows[:2]] == ["≥ 1000", "≥ 1000"]
