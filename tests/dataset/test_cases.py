"""Datasets of several cases, each with its own tables, labels and physics, and of own sensors."""

import shutil
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
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
    load_recipe,
    scene_of,
)
from chromagrip.dataset.torch import Frames
from chromagrip.render import load_sensor
from chromagrip.scene.scene import load_scene

Digests = Callable[[Path], dict[str, str]]
BOTH = Recipe(
    sequences=4,
    scene={"duration_s": 0.02, "camera": {"rate_hz": 60.0, "noise_levels": 0.0}},
    draw={"sensor": {"each": ["dome-2020", "thesis"]}, "object.friction": {"uniform": [0.3, 0.8]}},
    cases=(
        Case(
            name="chain",
            scene={"fingertip": {"nodes": 101, "step_ms": 5.0}, "camera": {"noise_levels": 1.0}},
            draw={"grip_n": {"uniform": [1.0, 2.0]}, "object.friction": {"choice": [0.9]}},
        ),
        Case(
            name="dome",
            scene={"body": "dome", "defects": {"jpeg_quality": 30}},
            draw={"motion": {"choice": ["move"]}, "pose.press_share": {"uniform": [0.2, 0.3]}},
        ),
    ),
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "both"
    make(BOTH, folder)
    return folder


def test_sequences_take_turns_at_cases_and_have_their_labels(made: Path) -> None:
    assert check(made) == 4
    assert load_recipe(str(made / "recipe.toml")) == BOTH
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
    # A sequence depends on its own case, not on what the others say.
    other = replace(BOTH.cases[0], name="other", draw={"grip_n": {"choice": [7.0]}})
    changed = replace(BOTH, cases=(other, BOTH.cases[1]))
    assert drawn(changed, 3) == drawn(BOTH, 3)
    assert drawn(changed, 2) != drawn(BOTH, 2)


def test_layouts_of_one_size_refuse_several(made: Path, tmp_path: Path) -> None:
    for layout, said in (("lerobot", "pictures of 640×480"), ("coco", "markers")):
        with pytest.raises(UserError, match=said):
            export(made, layout, tmp_path / layout)
        assert not (tmp_path / layout).exists()
    assert export(made, "tapvid", tmp_path / "tapvid")
    pytest.importorskip("torch")
    with pytest.raises(UserError, match=r"'x_px' has \d+ values in some sequences and 800"):
        Frames(made, labels=("x_px",))


RECIPE = """
sequences = 2
[scene]
duration_s = 0.03
[[cases]]
name = "mine"
[cases.scene]
sensor = "mine.toml"
[draw]
"object.friction" = { uniform = [0.3, 0.6] }
"""


def written(folder: Path, recipe: str = RECIPE) -> Path:
    """A recipe, its sensor and the file of places that this names, each beside the other."""
    folder.mkdir(parents=True)
    design = files("chromagrip.render").joinpath("designs/thesis.toml").read_text(encoding="utf-8")
    start, end = design.index("[layout]"), design.index("# Stiff dots")
    layout = '[layout]\nkind = "file"\npath = "places/grid.csv"\n\n'
    (folder / "mine.toml").write_text(design[:start] + layout + design[end:], encoding="utf-8")
    (folder / "places").mkdir()
    places = np.degrees(load_sensor("thesis").places[:60])
    lines = ["theta_deg,phi_deg", *(f"{theta},{phi}" for theta, phi in places)]
    (folder / "places" / "grid.csv").write_text("\n".join(lines), encoding="utf-8")
    (folder / "recipe.toml").write_text(recipe, encoding="utf-8")
    return folder / "recipe.toml"


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset whose recipe and sensor are gone, in another place than it was made in."""
    folder = tmp_path_factory.mktemp("own")
    make(load_recipe(str(written(folder / "here"))), folder / "data")
    shutil.rmtree(folder / "here")
    (folder / "data").rename(folder / "moved")
    return folder / "moved"


def test_it_is_read_where_nothing_else_is(own: Path) -> None:
    assert check(own) == 2
    for one in load_sequences(own):
        assert one.places.shape[2] == 60
        assert len(one.scene.build_sensor().places) == 60
    scene = load_scene(str(own / "sequence-000001" / "scene.toml"))
    assert Path(scene.sensor).samefile(own / "sensors" / "mine" / "mine.toml")
    text = [file.read_text("utf-8") for file in own.rglob("*") if file.suffix in (".toml", ".json")]
    assert not [one for one in text if str(own.parent) in one]


def test_other_sensors_are_other_datasets(own: Path, tmp_path: Path, bytes_of: Digests) -> None:
    folder = shutil.copytree(own, tmp_path / "data")
    path = written(tmp_path / "here")
    grid = tmp_path / "here" / "places" / "grid.csv"
    grid.write_text("\n".join(grid.read_text("utf-8").splitlines()[:-1]), encoding="utf-8")
    other, before = load_recipe(str(path)), bytes_of(folder)
    with pytest.raises(UserError, match=r"another sensor: sensors/mine/grid\.csv differs"):
        make(other, folder, resume=True)
    assert bytes_of(folder) == before
    make(other, tmp_path / "shard", shard=(2, 2))
    with pytest.raises(UserError, match="shard is of another sensor than"):
        merge([folder, tmp_path / "shard"], tmp_path / "merged")
    with (folder / "sensors" / "mine" / "grid.csv").open("a", encoding="utf-8") as file:
        file.write("\n1.0,2.0\n")
    with pytest.raises(UserError, match=r"grid\.csv has changed"):
        check(folder)


def test_two_files_of_one_name_are_refused(tmp_path: Path) -> None:
    """They would be one in the dataset."""
    for name in "ab":
        written(tmp_path / name)
    draw = {"sensor": {"choice": [str(tmp_path / name / "mine.toml") for name in "ab"]}}
    tiny = load_recipe("tiny")
    with pytest.raises(UserError, match=r"one sensor of a name; there are two mine\.toml"):
        make(replace(tiny, draw=draw), tmp_path / "data")
