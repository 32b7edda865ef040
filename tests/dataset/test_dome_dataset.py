"""Datasets of a dome: whole, with pixels that carry the force; meshes come along."""

import io
import shutil
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from msgspec.structs import replace

from chromagrip import UserError
from chromagrip.dataset import load_sequences
from chromagrip.dataset import sequence as one_sequence
from chromagrip.dataset.check import check
from chromagrip.dataset.export.layouts import export
from chromagrip.dataset.folder import TABLE, sequence_name
from chromagrip.dataset.make import make, merge
from chromagrip.dataset.recipe import Recipe, load_recipe, pose_of, scene_of
from chromagrip.dataset.sequence import sequence, shots

DRAW: dict[str, Any] = {
    "motion": {"choice": ["move"]},
    "pose.press_share": {"uniform": [0.2, 0.3]},
    "pose.shear_mm": {"choice": [0.6]},
    "pose.shear_towards_deg": {"uniform": [0.0, 360.0]},
    "pose.twist_deg": {"choice": [20.0]},
    "pose.tilt_deg": {"choice": [5.0]},
    "object": {"choice": [{"shape": "capsule", "size_mm": [4.0, 12.0]}, {"radius_mm": 12.0}]},
    "object.stiffness_kpa": {"uniform": [200.0, 400.0]},
}
SCENE = {
    "body": "dome", "duration_s": 0.1, "camera": {"rate_hz": 60.0}, "dome": {"pitch_mm": 0.8},
}  # fmt: skip
SMALL = Recipe(sequences=2, scene=SCENE, draw=DRAW)
#: Images of the truth take most of the time: three frames of one sequence.
PICTURED = replace(
    SMALL,
    sequences=1,
    scene=SCENE | {"camera": {"rate_hz": 24.0}},
    truth=("traction", "contact", "depth"),
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "small"
    make(SMALL, folder)
    return folder


@pytest.fixture(scope="module")
def pictured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "pictured"
    make(PICTURED, folder)
    return folder


def test_a_dataset_of_a_dome_is_whole(made: Path) -> None:
    assert check(made) == 2
    one = next(iter(load_sequences(made)))
    assert one.frames["contact_nodes"].max() > 10
    assert set(one.frames["slip_state"]) & {"incipient", "gross"}
    assert one.markers["node_slips"].any()


def test_the_pixels_carry_the_force(pictured: Path) -> None:
    """∫ traction over the skin = F: pixels are weighted by the skin that they see."""
    assert check(pictured) == 1
    one = next(iter(load_sequences(pictured)))
    truth = np.load(pictured / sequence_name(0) / "truth-002.npz")
    assert truth["traction"].shape == (480, 640, 3)
    shown = abs(np.nan_to_num(truth["traction"])).max(axis=-1) > 0.0
    assert (truth["contact"] == shown).all()
    area = one.markers["node_area_mm2"][2]
    force = [one.frames[f"force_{axis}_n"][2] for axis in "xyz"]
    normal = one.markers["node_normal_n"][2]
    # The largest pressure that a pixel shows is that of a node.
    assert abs(truth["traction"][shown]).max() == pytest.approx(
        1e6 * (normal / area).max(), rel=0.25
    )
    mean = truth["traction"][shown].mean(axis=0)
    cosine = mean @ force / np.linalg.norm(mean) / np.linalg.norm(force)
    assert cosine > 0.97


def test_what_came_before_changes_no_byte() -> None:
    after = [shot.image for shot in shots(SMALL, sequence(SMALL, 1))[1]]
    for name in ("_map", "_renderer"):
        getattr(one_sequence, name).cache_clear()
    alone = [shot.image for shot in shots(SMALL, sequence(SMALL, 1))[1]]
    assert all((a == b).all() for a, b in zip(after, alone, strict=True))


def test_forces_drive_an_object_too(tmp_path: Path) -> None:
    draw = {"motion": {"choice": ["slip"]}, "grip_n": {"choice": [1.0]}}
    make(replace(SMALL, sequences=1, draw=draw), tmp_path / "slip")
    assert check(tmp_path / "slip") == 1
    one = next(iter(load_sequences(tmp_path / "slip")))
    assert one.frames["load_n"].max() > 0.5


def test_a_tilt_leans_the_way_that_was_drawn() -> None:
    scene = scene_of(SMALL, 0, {})
    values = {"pose.tilt_deg": 10.0, "pose.tilt_towards_deg": 90.0, "pose.shear_mm": 2.0}
    pose = pose_of(values | {"pose.shear_towards_deg": 90.0, "pose.press_share": 0.5}, scene)
    assert pose.shear == pytest.approx((0.0, 2e-3), abs=1e-12)
    # A positive turn about x leads z to −y; the top leans to +y by a negative one.
    assert pose.tilt == pytest.approx((-np.radians(10.0), 0.0), abs=1e-12)
    assert pose.press == pytest.approx(0.5 * scene.build_dome().thickness)


def _meshes(folder: Path) -> Path:
    trimesh = pytest.importorskip("trimesh")
    folder.mkdir()
    for size in (6.0, 9.0):
        trimesh.creation.icosphere(subdivisions=3, radius=size).export(folder / f"ball-{size}.stl")
    return folder


@pytest.mark.data
def test_meshes_come_along_and_are_split_by_object(tmp_path: Path) -> None:
    recipe = load_recipe("objects", _meshes(tmp_path / "parts"))
    recipe = replace(recipe, sequences=2, scene={**recipe.scene, **SCENE, "sensor": "thesis"})
    recipe = replace(recipe, draw=recipe.draw | {"object.stiffness_kpa": {"choice": [200.0]}})
    make(recipe, tmp_path / "first", shard=(1, 2))
    make(recipe, tmp_path / "second", shard=(2, 2))
    merge([tmp_path / "second", tmp_path / "first"], tmp_path / "whole")
    for gone in ("parts", "first", "second"):
        shutil.rmtree(tmp_path / gone)
    (tmp_path / "whole").rename(tmp_path / "moved")
    assert check(tmp_path / "moved") == 2
    rows = pq.read_table(tmp_path / "moved" / TABLE).to_pylist()
    assert all((tmp_path / "moved" / "x" / row["object.mesh"]).resolve().is_file() for row in rows)


def test_a_mesh_that_cannot_be_used_is_said_at_once(tmp_path: Path) -> None:
    folder = _meshes(tmp_path / "parts")
    (folder / "bad.stl").write_bytes(b"nothing")
    with pytest.raises(UserError, match=r"bad\.stl: it has no triangles"):
        load_recipe("objects", folder)


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "move of a chain": ({"scene": {}}, "draw.motion: allowed are press, grasp, slip"),
    "traction of a chain": (
        {"scene": {}, "draw": {}, "truth": ("traction",)},
        "truth 'traction' needs a recipe with scene.body",
    ),
    "pose of a press": (
        {"draw": {"pose.twist_deg": {"choice": [3.0]}}},
        'draw.pose.twist_deg needs draw.motion to have "move"',
    ),
    "too deep": (
        {"draw": DRAW | {"pose.press_share": {"uniform": [0.1, 0.95]}}},
        "draw.pose.press_share reaches 0.95; 0 to 0.8 is allowed",
    ),
    "two bodies": (
        {"draw": DRAW | {"body": {"choice": ["dome", "chain"]}}},
        "draw.body: a body is not drawn",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_a_body_does_not_have_is_refused(name: str, tmp_path: Path) -> None:
    from chromagrip.dataset.recipe import dump_recipe

    changes, said = REFUSED[name]
    path = tmp_path / "mine.toml"
    path.write_text(dump_recipe(replace(SMALL, **changes)), "utf-8")
    with pytest.raises(UserError) as raised:
        load_recipe(str(path))
    assert said in str(raised.value)


def test_labels_that_a_body_does_not_have_are_refused_before_the_start(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="truth 'contact' needs a recipe"):
        make(replace(load_recipe("tiny"), truth=("contact",)), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_meshes_are_asked_for(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="give --meshes FOLDER"):
        load_recipe("objects")
    with pytest.raises(UserError, match="has no mesh"):
        load_recipe("objects", tmp_path)
    with pytest.raises(UserError, match="meshes are for a recipe with"):
        load_recipe("tiny", tmp_path)


def test_other_layouts_take_a_dome_too(pictured: Path, tmp_path: Path) -> None:
    for layout in ("webdataset", "lerobot"):
        assert export(pictured, layout, tmp_path / layout)
    with tarfile.open(tmp_path / "webdataset" / "frames-000000.tar") as tar:
        file = tar.extractfile("000000-002.npz")
        assert file is not None
        nodes = np.load(io.BytesIO(file.read()))
    one = next(iter(load_sequences(pictured)))
    assert np.array_equal(nodes["node_friction_y_n"], one.markers["node_friction_y_n"][2])
    table = pq.read_table(tmp_path / "lerobot" / "data" / "chunk-000" / "file-000.parquet")
    wrench = np.array(table["observation.wrench"].to_pylist())[: len(one.pictures)].T
    for k, axis in enumerate("xyz"):
        np.testing.assert_allclose(wrench[k], one.frames[f"force_{axis}_n"], rtol=1e-6)
        torque = 1e-3 * one.frames[f"torque_{axis}_nmm"]
        np.testing.assert_allclose(wrench[3 + k], torque, rtol=1e-6)
