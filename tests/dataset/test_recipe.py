"""Recipes: what they draw, what the documentation shows, and what is refused before the start."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from msgspec.structs import replace
from scipy import stats

from chromagrip import UserError
from chromagrip.dataset.draws import draw
from chromagrip.dataset.recipe import (
    Recipe,
    drawn,
    dump_recipe,
    load_recipe,
    pose_of,
    recipe_names,
    scene_of,
)

TINY = load_recipe("tiny")
DOME: dict[str, Any] = {"body": "dome", "sensor": "thesis"}


def test_more_sequences_begin_with_the_same() -> None:
    more = replace(TINY, sequences=300)
    assert drawn(more, 2) == drawn(TINY, 2)
    other = replace(TINY, draw={**TINY.draw, "camera.rate_hz": {"choice": [60.0]}})
    assert drawn(other, 2).items() >= drawn(TINY, 2).items()


def test_draws_are_of_their_distributions() -> None:
    for how, law in (
        ({"uniform": [2.0, 5.0]}, stats.uniform(2.0, 3.0)),
        ({"log_uniform": [0.5, 8.0]}, stats.loguniform(0.5, 8.0)),
        ({"normal": [1.0, 0.5, 0.0, 3.0]}, stats.truncnorm(-2.0, 4.0, 1.0, 0.5)),
    ):
        rng = np.random.default_rng(1)
        values = [draw(how, rng, turn) for turn in range(2000)]
        assert stats.kstest(values, law.cdf).pvalue > 1e-3
    assert [draw({"each": [1, 2, 3]}, rng, turn) for turn in range(4)] == [1, 2, 3, 1]
    assert {draw({"choice": [1, 2, 3]}, rng, 0) for _ in range(50)} == {1, 2, 3}


def test_every_shipped_recipe_gives_scenes() -> None:
    for name in recipe_names():
        if name == "objects":  # of the user's own meshes, see test_dome_dataset.py
            continue
        recipe = load_recipe(name)
        for number in range(3):
            assert scene_of(recipe, number, drawn(recipe, number)).path == "truth"
    assert "cases" not in dump_recipe(TINY)  # bytes of a recipe are those of before there were any


def test_the_recipes_of_the_documentation_are_recipes(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "datasets.md").read_text(encoding="utf-8")
    blocks = [part.split("```")[0] for part in text.split("```toml\n")[1:]]
    (cases,) = [block for block in blocks if "[[cases]]" in block]
    recipes = []
    for block in (blocks[0], cases):
        (tmp_path / "mine.toml").write_text(block, encoding="utf-8")
        recipes.append(load_recipe(str(tmp_path / "mine.toml")))
    assert recipes[0].draw["share"] == {"uniform": [0.0, 0.95]}
    found = [(drawn(recipes[1], k)["case"], drawn(recipes[1], k)["sensor"]) for k in range(4)]
    assert found == [
        ("chain, JPEG", "thesis"), ("dome", "thesis"), ("chain, JPEG", "fovea"), ("dome", "fovea"),
    ]  # fmt: skip


def test_a_pose_leans_and_moves_the_way_that_was_drawn() -> None:
    scene = scene_of(Recipe(scene=DOME, draw={"motion": {"choice": ["move"]}}), 0, {})
    values = {"pose.tilt_deg": 10.0, "pose.tilt_towards_deg": 90.0, "pose.shear_mm": 2.0}
    pose = pose_of(values | {"pose.shear_towards_deg": 90.0, "pose.press_share": 0.5}, scene)
    assert pose.shear == pytest.approx((0.0, 2e-3), abs=1e-12)
    # A positive turn about x leads z to −y; the top leans to +y by a negative one.
    assert pose.tilt == pytest.approx((-math.radians(10.0), 0.0), abs=1e-12)
    assert pose.press == pytest.approx(0.5 * scene.build_dome().thickness)


def one_of(name: str, *values: object) -> dict[str, Any]:
    return {"draw": {name: {"choice": [*values]}}}


MOVE = {"motion": {"choice": ["move"]}}
TWO: list[dict[str, Any]] = [{"name": "a"}, {"name": "b"}]
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"draw": {"object.friction": {"uniform": [0.2, 90.0]}}}, "draw.object.friction reaches 90"),
    ({"draw": {"grip_n": {"uniform": [2.0, 1.0]}}}, "the range from 2.0 to 1.0 is empty"),
    ({"draw": {"grip_n": {"each": []}}}, "each needs something to choose from"),
    (one_of("motion", "grasp"), "draw.share is needed"),
    ({"scene": {"calibration": "c.toml"}}, "are read as designed"),
    ({"truth": ["traction"]}, "truth 'traction' needs a recipe with scene.body"),
    (
        {"scene": DOME, "draw": MOVE | {"pose.press_share": {"uniform": [0.1, 0.95]}}},
        "draw.pose.press_share reaches 0.95; 0 to 0.8 is allowed",
    ),
    ({"scene": DOME} | one_of("body", "dome", "chain"), "draw.body: a body is not drawn"),
    (
        {"cases": [TWO[0], TWO[1] | one_of("object.friction", 90.0)]},
        "case b: draw.object.frict",
    ),
    (
        one_of("object.friction", 0.5)
        | {"cases": [{"name": "a", "scene": {"object": {"friction": 0.4}}}]},
        "case a: object.friction is set and drawn",
    ),
]


def test_a_recipe_that_leaves_what_can_be_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    for tables, said in REFUSED:
        path.write_text(tomli_w.dumps(tables), encoding="utf-8")
        with pytest.raises(UserError, match=said):
            load_recipe(str(path))


def test_meshes_are_asked_for(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "bad.stl").write_bytes(b"nothing")
    for words, said in (
        (("objects",), "give --meshes FOLDER"),
        (("objects", tmp_path / "parts"), r"bad\.stl: it has no triangles"),
        (("tiny", tmp_path), "meshes are for a recipe with"),
    ):
        with pytest.raises(UserError, match=said):
            load_recipe(*words)
