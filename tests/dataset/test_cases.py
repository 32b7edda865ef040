"""Datasets of several cases: each sequence has the tables, labels and physics of its own case."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import tomli_w
from msgspec.structs import replace

from chromagrip import UserError
from chromagrip.dataset import load_sequences
from chromagrip.dataset.check import check
from chromagrip.dataset.export.layouts import export
from chromagrip.dataset.folder import TABLE
from chromagrip.dataset.labels import columns_of
from chromagrip.dataset.make import make, merge
from chromagrip.dataset.recipe import (
    Case,
    Recipe,
    bodies_of,
    cases_of,
    drawn,
    dump_recipe,
    load_recipe,
    scene_of,
)
from chromagrip.dataset.torch import Frames

Digests = Callable[[Path], dict[str, str]]
BOTH = Recipe(
    sequences=4,
    scene={"duration_s": 0.05, "camera": {"rate_hz": 60.0, "noise_levels": 0.0}},
    draw={"sensor": {"each": ["dome-2020", "thesis"]}, "object.friction": {"uniform": [0.3, 0.8]}},
    cases=(
        Case(
            name="chain",
            scene={"fingertip": {"nodes": 101, "step_ms": 5.0}, "camera": {"noise_levels": 1.0}},
            draw={"grip_n": {"uniform": [1.0, 2.0]}, "object.friction": {"choice": [0.9]}},
        ),
        Case(
            name="dome",
            scene={"body": "dome", "dome": {"pitch_mm": 0.8}, "defects": {"jpeg_quality": 30}},
            draw={"motion": {"choice": ["move"]}, "pose.press_share": {"uniform": [0.2, 0.3]}},
        ),
    ),
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "both"
    make(BOTH, folder)
    return folder


def test_sequences_take_turns_at_cases_and_at_each_value(made: Path) -> None:
    assert check(made) == 4
    found = [(one.values["case"], one.scene.body, one.scene.sensor) for one in load_sequences(made)]
    assert found == [
        ("chain", "chain", "dome-2020"),
        ("dome", "dome", "dome-2020"),
        ("chain", "chain", "thesis"),
        ("dome", "dome", "thesis"),
    ]
    rows = pq.read_table(made / TABLE).to_pylist()
    assert [row["case"] for row in rows] == ["chain", "dome", "chain", "dome"]
    assert [row["grip_n"] is None for row in rows] == [False, True, False, True]


def test_labels_follow_the_body(made: Path) -> None:
    for one in load_sequences(made):
        columns = columns_of(one.scene.body)
        assert list(one.frames) == list(columns.frame)
        assert list(one.markers) == [*columns.markers, *columns.nodes]
        assert one.frames["contact_nodes"].max() > 0
    card = (made / "DATASET_CARD.md").read_text("utf-8")
    assert "`force_x_n`" in card
    assert "`node_mu`" in card
    assert "`defects.jpeg_quality` = 30" in card


def test_a_case_stands_before_what_is_shared() -> None:
    chain, dome = cases_of(BOTH)
    assert chain.scene["camera"] == {"rate_hz": 60.0, "noise_levels": 1.0}
    assert dome.scene["camera"] == {"rate_hz": 60.0, "noise_levels": 0.0}
    assert BOTH.scene["camera"] == {"rate_hz": 60.0, "noise_levels": 0.0}
    assert drawn(BOTH, 0)["object.friction"] == 0.9
    assert 0.3 <= drawn(BOTH, 1)["object.friction"] <= 0.8
    assert scene_of(BOTH, 0, drawn(BOTH, 0)).object.friction == 0.9
    assert bodies_of(BOTH) == ["chain", "dome"]
    assert bodies_of(replace(BOTH, cases=())) == ["chain"]


def test_a_case_alone_draws_the_same() -> None:
    """A sequence depends on its own case, not on what the others say."""
    other = replace(BOTH.cases[0], name="other", draw={"grip_n": {"choice": [7.0]}})
    changed = replace(BOTH, cases=(other, BOTH.cases[1]))
    assert drawn(changed, 3) == drawn(BOTH, 3)
    assert drawn(changed, 2) != drawn(BOTH, 2)


def test_compression_of_a_case_is_in_its_pictures_alone(made: Path) -> None:
    """JPEG codes blocks of 8 × 8 pixels: where it is coarse, differences are larger across them."""
    steps = []
    for one in list(load_sequences(made))[2:]:
        image = next(one.images()).astype(float).mean(axis=2)
        change = abs(np.diff(image, n=2, axis=1))[:, : 8 * (image.shape[1] // 8) - 8]
        columns = change.mean(axis=0).reshape(-1, 8).mean(axis=0)  # those about 7 | 8 stand at 6, 7
        steps.append(columns[6:].mean() / columns[:6].mean())
    assert steps[0] == pytest.approx(1.0, abs=0.1)
    assert steps[1] > 1.15


@pytest.mark.data
def test_shards_of_cases_are_merged_and_read_back(
    made: Path, tmp_path: Path, bytes_of: Digests
) -> None:
    for first in (2, 1):
        make(BOTH, tmp_path / f"shard{first}", shard=(first, 2))
    merge([tmp_path / "shard2", tmp_path / "shard1"], tmp_path / "merged")
    assert bytes_of(tmp_path / "merged") == bytes_of(made)
    assert load_recipe(str(made / "recipe.toml")) == BOTH


def test_a_recipe_without_cases_is_written_without() -> None:
    """Its bytes are those of before there were cases."""
    assert "cases" not in dump_recipe(load_recipe("tiny"))


def test_the_cases_of_the_documentation_are_a_recipe(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "datasets.md").read_text(encoding="utf-8")
    blocks = [part.split("```")[0] for part in text.split("```toml\n")[1:]]
    (block,) = [block for block in blocks if "[[cases]]" in block]
    (tmp_path / "mine.toml").write_text(block, encoding="utf-8")
    recipe = load_recipe(str(tmp_path / "mine.toml"))
    found = [(drawn(recipe, k)["case"], drawn(recipe, k)["sensor"]) for k in range(4)]
    assert found == [
        ("chain, JPEG", "thesis"), ("dome", "thesis"), ("chain, JPEG", "fovea"), ("dome", "fovea"),
    ]  # fmt: skip


def test_files_of_cases_come_along(tmp_path: Path) -> None:
    text = {"cases": [{"name": "mine", "scene": {"sensor": "mine.toml"}}]}
    (tmp_path / "here.toml").write_text(tomli_w.dumps(text), encoding="utf-8")
    design = Path(__file__).parents[2] / "render" / "designs" / "dome-2020.toml"
    (tmp_path / "mine.toml").write_bytes(design.read_bytes())
    recipe = load_recipe(str(tmp_path / "here.toml"))
    make(replace(recipe, sequences=1, scene={"duration_s": 0.03}), tmp_path / "data")
    (tmp_path / "mine.toml").unlink()
    assert check(tmp_path / "data") == 1
    assert (tmp_path / "data" / "sensors" / "mine" / "mine.toml").is_file()


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        ({"cases": [{"name": "a"}, {"name": "a"}]}, "two cases have the name 'a'"),
        ({"cases": [{}]}, "name"),
        ({"draw": {"case": {"choice": ["a"]}}}, "cases are not drawn"),
        ({"cases": [{"name": "a", "draw": {"case": {"choice": ["a"]}}}]}, "cases are not drawn"),
        ({"cases": [{"name": "a", "truth": ["flow"]}]}, "truth"),
        (
            {
                "cases": [
                    {"name": "a"},
                    {"name": "b", "draw": {"object.friction": {"each": [90.0]}}},
                ]
            },
            "case b: draw.object.friction reaches 90",
        ),
        ({"cases": [{"name": "a", "scene": {"body": "x"}}]}, "case a: body = 'x': allowed: chain"),
        ({"draw": {"grip_n": {"each": []}}}, "each needs something to choose from"),
        (
            {
                "draw": {"object.friction": {"choice": [0.5]}},
                "cases": [{"name": "a", "scene": {"object": {"friction": 0.4}}}],
            },
            "case a: object.friction is set and drawn",
        ),
        (
            {"truth": ["contact"], "cases": [{"name": "a"}, {"name": "b"}]},
            "truth 'contact' needs a recipe with",
        ),
        (
            {
                "truth": ["contact"],
                "scene": {"body": "dome"},
                "cases": [{"name": "a"}, {"name": "b", "scene": {"body": "chain"}}],
            },
            "truth 'contact' needs a recipe with",
        ),
    ],
)
def test_cases_that_cannot_be_are_refused(
    tmp_path: Path, tables: dict[str, object], said: str
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")
    with pytest.raises(UserError, match=said):
        load_recipe(str(path))


def test_layouts_of_one_size_refuse_several(made: Path, tmp_path: Path) -> None:
    for layout, said in (("lerobot", "pictures of 640×480"), ("coco", "markers")):
        with pytest.raises(UserError, match=said):
            export(made, layout, tmp_path / layout)
        assert not (tmp_path / layout).exists()
    assert export(made, "tapvid", tmp_path / "tapvid")
    pytest.importorskip("torch")
    with pytest.raises(UserError, match=r"'x_px' has \d+ values in some sequences and 800"):
        Frames(made, labels=("x_px",))
    with pytest.raises(UserError, match="no label 'force_x_n'"):
        Frames(made, labels=("force_x_n",))
    assert len(Frames(made, labels=("normal_n",))) == sum(
        len(one.pictures) for one in load_sequences(made)
    )
