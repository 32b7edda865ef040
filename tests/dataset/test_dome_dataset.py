"""Datasets of a dome: pixels that carry the force, forces that were read again, meshes."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from msgspec.structs import replace

from chromagrip import UserError
from chromagrip.cli.pictures import estimate
from chromagrip.dataset import Loaded, load_sequences
from chromagrip.dataset.check import check
from chromagrip.dataset.folder import CARD, TABLE, read_manifest, sequence_name
from chromagrip.dataset.frozen import digests_of
from chromagrip.dataset.labels import INTERVALS, READ, READING
from chromagrip.dataset.labels.reading import reading_lines
from chromagrip.dataset.make import make, merge
from chromagrip.dataset.read import tables
from chromagrip.dataset.recipe import Recipe, load_recipe
from chromagrip.sensing.reader import Reader


@pytest.fixture(scope="module")
def loaded(pressed: Path) -> list[Loaded]:
    return list(load_sequences(pressed))


def test_pixels_carry_the_force_and_the_motion(pressed: Path, loaded: list[Loaded]) -> None:
    """∫ traction over the skin = F: pixels are weighted by the skin that they see."""
    assert check(pressed) == 1
    one = loaded[0]
    assert one.frames["contact_nodes"].max() > 10
    truth = np.load(pressed / sequence_name(0) / "truth-001.npz")
    view = one.scene.build_sensor().view
    assert truth["traction"].shape == (view.height, view.width, 3)
    shown = abs(np.nan_to_num(truth["traction"])).max(axis=-1) > 0.0
    assert (truth["contact"] == shown).all()
    area = one.markers["node_area_mm2"][1]
    force = [one.frames[f"force_{axis}_n"][1] for axis in "xyz"]
    # The largest pressure that a pixel shows is that of a node.
    largest = 1e6 * (one.markers["node_normal_n"][1] / area).max()
    assert abs(truth["traction"][shown]).max() == pytest.approx(largest, rel=0.25)
    mean = truth["traction"][shown].mean(axis=0)
    assert mean @ force / np.linalg.norm(mean) / np.linalg.norm(force) > 0.97
    # Optical flow where a marker rests is the motion of its label.
    middle = np.stack([one.markers[f"projected_{axis}_px"] for axis in "xy"], axis=-1)
    middle = middle.reshape(2, 2, -1, 2)
    moved = middle[1] - middle[0]
    assert np.nanmax(abs(moved)) > 0.5
    flow = truth["flow"] - np.load(pressed / sequence_name(0) / "truth-000.npz")["flow"]
    for layer in range(2):
        at = np.rint(np.nan_to_num(middle[0, layer])).astype(int)
        inside = np.hypot(*(at - [view.width / 2, view.height / 2]).T) < 0.3 * view.height
        np.testing.assert_allclose(
            flow[layer][at[inside, 1], at[inside, 0]], moved[layer, inside], atol=0.15
        )


def test_a_reading_is_near_the_truth_and_says_how_near(loaded: list[Loaded]) -> None:
    for one in loaded:
        frames = one.frames
        assert not any(frames[f"{READ}no_estimate"])
        for name, slack in (("force_x_n", 0.03), ("force_y_n", 0.03), ("force_z_n", 0.1)):
            low, value, high = (frames[column][-1] for column in INTERVALS[name])
            assert low < value < high
            assert value == pytest.approx(frames[name][-1], abs=slack * frames["normal_n"][-1])
            # Two half-widths off would be wrong and narrow.
            assert abs(value - frames[name][-1]) < high - low


@pytest.mark.data
def test_a_reading_comes_from_the_pictures_alone(loaded: list[Loaded]) -> None:
    """The files that anybody has are read again, without the labels."""
    one = loaded[0]
    reader = Reader("dome-2022", [one.pictures.rest], noise=1.0, window=0.05)
    for k, image in enumerate(one.images()):
        seen = reader.update(image, k / 20.0).observation
        assert seen is not None
        assert one.frames[f"{READ}normal_n"][k] == pytest.approx(seen.field.total_normal)
        for axis, force in zip("xyz", seen.force, strict=True):
            assert one.frames[f"{READ}force_{axis}_n"][k] == pytest.approx(force)
        assert one.frames[f"{READ}torque_z_nmm"][k] == pytest.approx(1e3 * seen.torque)


def test_what_nothing_reads_says_why(presses: Recipe, tmp_path: Path) -> None:
    scene = presses.scene | {"sensor": "flat-2019"}
    make(replace(presses, sequences=1, truth=(), scene=scene), tmp_path / "pad")
    assert check(tmp_path / "pad") == 1
    frames = next(iter(load_sequences(tmp_path / "pad"))).frames
    assert all("flat" in reason for reason in frames[f"{READ}no_estimate"])
    assert all(np.isnan(frames[name]).all() for names in INTERVALS.values() for name in names)
    assert not frames[f"{READ}mu_observable"].any()
    with pytest.raises(UserError, match="no reading 'magic'; there is auto"):
        make(replace(presses, reading="magic"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.data
def test_a_reading_changes_no_label_and_no_picture(tmp_path: Path) -> None:
    tiny = replace(load_recipe("tiny"), sequences=1)
    make(tiny, tmp_path / "plain")
    make(replace(tiny, reading="auto"), tmp_path / "read")
    plain, read = (tmp_path / name / sequence_name(0) for name in ("plain", "read"))
    assert digests_of(plain) == digests_of(read)
    assert not set(READING) & set(pq.read_schema(plain / "frames.parquet").names)


def test_a_reading_outside_of_its_interval_is_named(
    pressed: Path, tmp_path: Path, respelled: Callable[..., None]
) -> None:
    folder = shutil.copytree(pressed, tmp_path / "data")
    respelled(folder, "frames", "reading_force_x_low_n", 1, 9.0)
    with pytest.raises(UserError, match=r"frame 1: reading_force_x_n is .*, outside of its inter"):
        check(folder)


def test_the_card_counts_what_is_covered(pressed: Path) -> None:
    """By hand: of frames in contact, errors and intervals."""
    text = (pressed / CARD).read_text("utf-8")
    rows = [
        [part[name][k] for name in ("force_z_n", *INTERVALS["force_z_n"])]
        for part in tables(pressed, read_manifest(pressed)["sequences"])
        for k, count in enumerate(part["contact_nodes"])
        if count
    ]
    covered = sum(low <= truth <= high for truth, low, _, high in rows) / len(rows)
    error = np.median([abs(value - truth) for truth, _, value, _ in rows])
    assert f"| `force_z_n` | {len(rows)} | {error:.2g} | {covered:.0%} |" in text
    assert "| `reading_margin_low` | – | read from the picture: lower end of its interval |" in text
    assert reading_lines("", []) == []


@pytest.mark.data
def test_truth_stands_next_to_the_estimates(
    pressed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = pressed / sequence_name(0), tmp_path / "out"
    pictures = (str(folder / "rest.png"), str(folder))
    own = {"calibration": "dome-2022", "fps": 20.0, "reconstructor": "contact"}
    assert estimate(*pictures, out=out, **own) == 0
    truth = json.loads((out / "summary.json").read_text())["truth"]
    for name in ("normal_n", "friction_n"):
        true, found = (
            pq.read_table(path)[name].to_numpy()
            for path in (folder / "frames.parquet", out / "estimates.parquet")
        )
        off = np.sqrt(np.mean((true - found) ** 2))
        assert truth[name]["rms_error"] == pytest.approx(off)
        assert off < 0.1 * true.max()
        assert truth[name]["last"] == true[-1]
    assert "at the end" in " ".join(capsys.readouterr().out.split())
    with pytest.raises(UserError, match="is of another sensor than"):
        estimate(*pictures, calibration="thesis")


@pytest.mark.data
def test_meshes_come_along_and_are_split_by_object(presses: Recipe, tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    (tmp_path / "parts").mkdir()
    for size in (6.0, 9.0):
        ball = trimesh.creation.icosphere(subdivisions=3, radius=size)
        ball.export(tmp_path / "parts" / f"ball-{size}.stl")
    recipe = load_recipe("objects", tmp_path / "parts")
    recipe = replace(recipe, sequences=2, scene={**recipe.scene, **presses.scene})
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
