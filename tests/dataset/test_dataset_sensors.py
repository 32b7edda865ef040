"""Datasets of sensors of one's own: they are read wherever they lie."""

import shutil
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from chromagrip.dataset import load_sequences
from chromagrip.dataset.check import check
from chromagrip.dataset.make import make, merge
from chromagrip.dataset.recipe import load_recipe
from chromagrip.errors import UserError
from chromagrip.render import load_sensor
from chromagrip.scene.scene import load_scene

Digests = Callable[[Path], dict[str, str]]
RECIPE = """
sequences = 2
[scene]
sensor = "mine.toml"
duration_s = 0.03
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
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset whose recipe and sensor are gone, in another place than it was made in."""
    folder = tmp_path_factory.mktemp("own")
    make(load_recipe(str(written(folder / "here"))), folder / "data")
    shutil.rmtree(folder / "here")
    (folder / "data").rename(folder / "moved")
    return folder / "moved"


def test_it_is_read_where_nothing_else_is(made: Path) -> None:
    assert check(made) == 2
    for one in load_sequences(made):
        assert one.places.shape[2] == 60
        assert len(one.scene.build_sensor().places) == 60
    scene = load_scene(str(made / "sequence-000001" / "scene.toml"))
    assert Path(scene.sensor).samefile(made / "sensors" / "mine" / "mine.toml")
    text = [
        file.read_text("utf-8") for file in made.rglob("*") if file.suffix in (".toml", ".json")
    ]
    assert not [one for one in text if str(made.parent) in one]


@pytest.mark.data
def test_bytes_rest_on_no_place(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bytes_of: Digests
) -> None:
    """Made elsewhere, named from elsewhere, in shards that are joined, and gone on with."""
    recipe = load_recipe(str(written(tmp_path / "deep" / "down")))
    monkeypatch.chdir(tmp_path)
    for shard in (1, 2):
        make(recipe, Path(f"shard-{shard}"), shard=(shard, 2))
    merge([Path("shard-1"), Path("shard-2")], Path("merged"))
    assert bytes_of(Path("merged")) == bytes_of(made)
    more = replace(load_recipe("merged/recipe.toml"), sequences=3)
    make(more, Path("merged"), resume=True)
    assert check(Path("merged")) == 3


def test_other_sensors_are_other_datasets(made: Path, tmp_path: Path, bytes_of: Digests) -> None:
    folder = shutil.copytree(made, tmp_path / "data")
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


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("mine.toml", "gone.toml"), "sensor file .*gone.toml cannot be read"),
        (
            ('[draw]\n"object.friction" = { uniform = [0.3, 0.6] }\n', "nodes = 3"),
            "unknown key nodes",
        ),
        (("duration_s", 'calibration = "c.toml"\nduration_s'), "are read as designed"),
    ],
)
def test_what_cannot_be_is_refused(change: tuple[str, str], said: str, tmp_path: Path) -> None:
    path = written(tmp_path / "here", RECIPE.replace(*change))
    with pytest.raises(UserError, match=said):
        load_recipe(str(path))


def test_two_sensors_of_one_name_are_refused(tmp_path: Path) -> None:
    written(tmp_path / "here" / "a")
    written(tmp_path / "here" / "b")
    text = 'sensor = { choice = ["a/mine.toml", "b/mine.toml"] }\n'
    path = tmp_path / "here" / "recipe.toml"
    path.write_text(RECIPE.replace('sensor = "mine.toml"\n', "") + text, encoding="utf-8")
    with pytest.raises(UserError, match=r"one sensor of a name; there are two mine\.toml"):
        make(load_recipe(str(path)), tmp_path / "data")


def test_two_files_of_one_name_are_refused(tmp_path: Path) -> None:
    """They would be one in the dataset."""
    path = written(tmp_path / "here")
    design = tmp_path / "here" / "mine.toml"
    lens = '[camera]\ncalibration = "lens/grid.csv"\n'
    design.write_text(design.read_text("utf-8").replace("[camera]\n", lens), encoding="utf-8")
    recipe = replace(load_recipe("tiny"), scene={"sensor": str(design)})
    (tmp_path / "here" / "lens").mkdir()
    (tmp_path / "here" / "lens" / "grid.csv").touch()
    with pytest.raises(UserError, match=r"copied: it names two files called grid\.csv"):
        make(recipe, path.parent / "data")
