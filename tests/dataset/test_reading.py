"""Readings beside the labels of a dataset: from pictures alone, with intervals, in every layout."""

import json
import shutil
import tarfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from msgspec.structs import replace

from chromagrip import UserError
from chromagrip.dataset import load_sequences
from chromagrip.dataset.check import check
from chromagrip.dataset.export.layouts import export
from chromagrip.dataset.export.lerobot import READ_FORCES
from chromagrip.dataset.folder import CARD, read_manifest, sequence_name
from chromagrip.dataset.frozen import digests_of
from chromagrip.dataset.labels import INTERVALS, READ, READING
from chromagrip.dataset.labels.reading import reading_lines
from chromagrip.dataset.make import make
from chromagrip.dataset.read import Loaded, tables
from chromagrip.dataset.recipe import Recipe, load_recipe
from chromagrip.dataset.sequence import sequence, shots
from chromagrip.sensing.reader import Reader

PRESS = {
    "motion": {"choice": ["move"]},
    "pose.press_share": {"choice": [0.25]},
    "pose.shear_mm": {"choice": [0.5]},
    "pose.shear_towards_deg": {"each": [40.0, 200.0]},
    "object.radius_mm": {"each": [12.0, 8.0]},
    "object.stiffness_kpa": {"choice": [400.0]},
}
DOME = Recipe(
    sequences=2,
    reading="auto",
    scene={
        "body": "dome", "sensor": "dome-2022", "duration_s": 0.2,
        "camera": {"rate_hz": 20.0, "noise_levels": 1.0},
    },
    draw=PRESS,
)  # fmt: skip
PAD = replace(DOME, sequences=1, scene=DOME.scene | {"sensor": "flat-2019"})


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("read") / "dome"
    make(DOME, folder)
    return folder


@pytest.fixture(scope="module")
def loaded(made: Path) -> list[Loaded]:
    return list(load_sequences(made))


def test_a_reading_is_near_the_truth_and_says_how_near(made: Path, loaded: list[Loaded]) -> None:
    assert check(made) == 2
    for one in loaded:
        frames = one.frames
        assert not any(frames[f"{READ}no_estimate"])
        for name, slack in (("force_x_n", 0.03), ("force_y_n", 0.03), ("force_z_n", 0.1)):
            low, value, high = (frames[column][-1] for column in INTERVALS[name])
            assert low < value < high
            assert value == pytest.approx(frames[name][-1], abs=slack * frames["normal_n"][-1])
            # Two half-widths beside it would be wrong and narrow.
            assert abs(value - frames[name][-1]) < high - low


def test_a_reading_comes_from_the_pictures_alone(loaded: list[Loaded]) -> None:
    """The files that anybody has are read again, without the labels."""
    one = loaded[1]
    reader = Reader("dome-2022", [one.pictures.rest], noise=1.0, window=0.05)
    for k, image in enumerate(one.images()):
        seen = reader.update(image, k / 20.0).observation
        assert seen is not None
        assert one.frames[f"{READ}normal_n"][k] == pytest.approx(seen.field.total_normal)
        for axis, force in zip("xyz", seen.force, strict=True):
            assert one.frames[f"{READ}force_{axis}_n"][k] == pytest.approx(force)
        assert one.frames[f"{READ}torque_z_nmm"][k] == pytest.approx(1e3 * seen.torque)


def test_a_sequence_before_changes_no_reading(loaded: list[Loaded]) -> None:
    _, frames = shots(DOME, sequence(DOME, 1))
    for k, shot in enumerate(frames):
        for name in READING:
            np.testing.assert_equal(shot.values[name], loaded[1].frames[name][k])


def test_a_sensor_that_nothing_reads_says_why(tmp_path: Path) -> None:
    make(PAD, tmp_path / "pad")
    assert check(tmp_path / "pad") == 1
    frames = next(iter(load_sequences(tmp_path / "pad"))).frames
    assert all("flat" in reason for reason in frames[f"{READ}no_estimate"])
    assert all(np.isnan(frames[name]).all() for names in INTERVALS.values() for name in names)
    assert not frames[f"{READ}mu_observable"].any()


@pytest.mark.data
def test_a_reading_changes_no_label_and_no_picture(tmp_path: Path) -> None:
    tiny = replace(load_recipe("tiny"), sequences=1)
    make(tiny, tmp_path / "plain")
    make(replace(tiny, reading="auto"), tmp_path / "read")
    plain, read = (tmp_path / name / sequence_name(0) for name in ("plain", "read"))
    assert digests_of(plain) == digests_of(read)
    assert not set(READING) & set(pq.read_schema(plain / "frames.parquet").names)


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("reading_force_x_low_n", 9.0, "reading_force_x_n is .*, outside of its interval"),
        ("reading_margin_high", -9.0, "reading_margin is .*, outside of its interval"),
        ("reading_mu", np.inf, "reading_mu is inf; allowed: .* or NaN"),
    ],
)
def test_a_reading_that_cannot_be_is_named(
    made: Path, tmp_path: Path, respelled: Callable[..., None], column: str, value: float, said: str
) -> None:
    folder = shutil.copytree(made, tmp_path / "spoilt")
    respelled(folder, "frames", column, 4, value)
    with pytest.raises(UserError, match=f"frame 4: {said}"):
        check(folder)


def test_layouts_that_have_forces_have_the_reading(
    made: Path, loaded: list[Loaded], tmp_path: Path
) -> None:
    export(made, "webdataset", tmp_path / "tar")
    with tarfile.open(tmp_path / "tar" / "frames-000000.tar") as tar:
        file = tar.extractfile("000001-003.json")
        assert file is not None
        values = json.load(file)
    frames = loaded[1].frames
    assert values["reading_force_z_n"] == frames["reading_force_z_n"][3]
    assert values["reading_no_estimate"] == ""
    export(made, "lerobot", tmp_path / "lerobot")
    info = json.loads((tmp_path / "lerobot" / "meta" / "info.json").read_text("utf-8"))
    feature = info["features"]["reading.forces"]
    assert feature["names"] == list(READ_FORCES)
    table = pq.read_table(tmp_path / "lerobot" / "data" / "chunk-000" / "file-000.parquet")
    row = table["reading.forces"].to_pylist()[len(loaded[0].pictures) + 3]
    at = feature["names"].index("reading_normal_n")
    assert row[at] == pytest.approx(frames["reading_normal_n"][3], rel=1e-6)


def test_the_card_counts_what_is_covered(made: Path) -> None:
    """By hand: of frames in contact, errors and intervals."""
    text = (made / CARD).read_text("utf-8")
    parts = list(tables(made, read_manifest(made)["sequences"]))
    rows = [
        [part[name][k] for name in ("force_z_n", *INTERVALS["force_z_n"])]
        for part in parts
        for k, count in enumerate(part["contact_nodes"])
        if count
    ]
    covered = sum(low <= truth <= high for truth, low, _, high in rows) / len(rows)
    error = sorted(abs(value - truth) for truth, _, value, _ in rows)
    middle = (error[(len(rows) - 1) // 2] + error[len(rows) // 2]) / 2
    assert f"| `force_z_n` | {len(rows)} | {middle:.2g} | {covered:.0%} |" in text
    assert "| `reading_margin_low` | – | read from the picture: lower end of its interval |" in text
    assert reading_lines("", []) == []


@pytest.mark.parametrize(
    ("reading", "said"),
    [
        (
            "sequential",
            'does not read body = "dome"; allowed are auto, contact',
        ),
        ("magic", "no reading 'magic'; there is auto, sequential"),
    ],
)
def test_readings_that_there_are_not_are_refused(reading: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=said):
        make(replace(DOME, reading=reading), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_words_are_no_label_of_a_network(made: Path) -> None:
    pytest.importorskip("torch")
    from chromagrip.dataset.torch import Frames

    assert Frames(made, labels=("reading_normal_n", "reading_mu_observable"))[1]
    with pytest.raises(UserError, match="'reading_no_estimate' is words"):
        Frames(made, labels=("reading_no_estimate",))
