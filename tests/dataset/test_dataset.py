"""Datasets: the same bytes however they are made, nothing half-written, and physics that holds."""

import hashlib
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest
import tomli_w
from msgspec.structs import replace

from chromagrip import UserError
from chromagrip.cli.pictures import estimate
from chromagrip.dataset import folder as dataset_folder
from chromagrip.dataset import load_sequences
from chromagrip.dataset.card import _shape_name
from chromagrip.dataset.check import check
from chromagrip.dataset.folder import FILES, MANIFEST, TABLE, sequence_name
from chromagrip.dataset.make import Backend, make, merge
from chromagrip.dataset.recipe import Recipe, drawn, load_recipe, recipe_names, scene_of
from chromagrip.dataset.sequence import sequence, shots
from chromagrip.dataset.split import split
from chromagrip.folders import filling
from chromagrip.scene.scene import load_scene

Digests = Callable[[Path], dict[str, str]]
TINY = load_recipe("tiny")


def copied(made: Path, to: Path) -> Path:
    """A copy that may be spoiled."""
    to.mkdir()
    for file in made.rglob("*"):
        target = to / file.relative_to(made)
        if file.is_dir():
            target.mkdir(exist_ok=True)
        else:
            target.parent.mkdir(exist_ok=True)
            target.write_bytes(file.read_bytes())
    return to


def test_a_whole_dataset_is_checked_and_has_no_clock_in_it(tiny: Path) -> None:
    assert check(tiny) == 3
    text = "".join(p.read_text("utf-8") for p in tiny.rglob("*") if p.suffix in (".json", ".toml"))
    assert os.uname().nodename not in text
    assert time.strftime("%Y-") not in text
    rows = pq.read_table(tiny / TABLE).to_pylist()
    assert [row["number"] for row in rows] == [0, 1, 2]
    assert (tiny / "contact-sheet.png").stat().st_size > 1000


def test_workers_shards_and_order_change_no_byte(
    tiny: Path, tmp_path: Path, bytes_of: Digests
) -> None:
    make(TINY, tmp_path / "two", workers=2)
    assert bytes_of(tmp_path / "two") == bytes_of(tiny)
    for first in (2, 1):
        make(TINY, tmp_path / f"shard{first}", shard=(first, 2))
    merge([tmp_path / "shard2", tmp_path / "shard1"], tmp_path / "merged")
    assert bytes_of(tmp_path / "merged") == bytes_of(tiny)


def test_more_sequences_begin_with_the_same(tiny: Path) -> None:
    more = replace(TINY, sequences=300)
    assert drawn(more, 2) == drawn(TINY, 2)
    other = replace(TINY, draw={**TINY.draw, "camera.rate_hz": {"choice": [60.0]}})
    assert drawn(other, 2).items() >= drawn(TINY, 2).items()


def test_what_a_killed_run_left_half_written_is_removed(
    tiny: Path, tmp_path: Path, bytes_of: Digests
) -> None:
    """A file and a folder of a process that is gone."""
    folder = copied(tiny, tmp_path / "killed")
    (folder / MANIFEST).unlink()
    (folder / f".part-1-{TABLE}").write_bytes(b"PAR1")
    (folder / ".part-sequence-000001-1").mkdir()
    (folder / ".part-sequence-000001-1" / "rest.png").write_bytes(b"")
    make(TINY, folder, resume=True)
    assert bytes_of(folder) == bytes_of(tiny)


@pytest.mark.data
def test_sigterm_ends_the_workers_too(tmp_path: Path) -> None:
    out = tmp_path / "ended"
    words = [sys.executable, "-P", "-m", "chromagrip", "dataset", "make", "tiny", "--n", "200"]
    process = subprocess.Popen(
        [*words, "--workers", "2", "--out", str(out)],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    deadline = time.monotonic() + 120.0
    while not list(out.glob("sequence-*")):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.05)
    workers = psutil.Process(process.pid).children(recursive=True)
    assert len(workers) >= 2
    process.terminate()
    assert process.wait(20.0) == 128 + signal.SIGTERM
    _, alive = psutil.wait_procs(workers, 20.0)
    assert not alive
    assert not (out / MANIFEST).exists()


@pytest.mark.data
def test_a_dask_worker_that_is_killed_loses_nothing(
    tiny: Path, tmp_path: Path, bytes_of: Digests
) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        victims = list(client.run(os.getpid).values())
        killed = []

        def kill(done: int, total: int) -> None:
            if done == 1 and not killed:
                killed.append(victims[0])
                os.kill(victims[0], signal.SIGKILL)

        make(
            TINY, tmp_path / "dask", backend="dask", address=cluster.scheduler_address,
            progress=kill,
        )  # fmt: skip
    assert killed
    assert bytes_of(tmp_path / "dask") == bytes_of(tiny)


def test_labels_are_what_opencv_projects(tiny: Path) -> None:
    """The thesis' camera sits in the centre of the port, which bends no ray."""
    one = next(iter(load_sequences(tiny)))
    store = cv2.FileStorage(str(one.pictures.folder / "camera.yml"), cv2.FILE_STORAGE_READ)
    matrix, bent = (
        store.getNode(f"{k}").mat() for k in ("camera_matrix", "distortion_coefficients")
    )
    centres = np.stack([one.markers[f"centre_{axis}_mm"] for axis in "xyz"], axis=-1)[5]
    centres[:, 2] -= store.getNode("position_mm").real()
    none = np.zeros(3)
    pixels, _ = cv2.fisheye.projectPoints(centres[:, None].astype(float), none, none, matrix, bent)
    told = np.stack([one.markers["projected_x_px"][5], one.markers["projected_y_px"][5]], axis=-1)
    seen = one.markers["visible"][5].astype(bool)
    np.testing.assert_allclose(pixels[seen, 0], told[seen], atol=1e-3)


def test_a_slip_goes_through_all_states() -> None:
    scene = {**TINY.scene, "duration_s": 1.0}
    draw = {
        "motion": {"choice": ["slip"]},
        "grip_n": {"choice": [2.0]},
        "slip_share": {"choice": [1.5]},
        "object.friction": {"choice": [0.4]},
    }
    recipe = Recipe(scene=scene, draw=draw)
    states = [shot.values["slip_state"] for shot in shots(recipe, sequence(recipe, 0))[1]]
    order = [state for k, state in enumerate(states) if k == 0 or states[k - 1] != state]
    assert order[-2:] == ["incipient", "gross"]
    assert order[0] == "none"


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda d: (d / "sequence-000001" / "frame-002.png").write_bytes(b"x"), "has changed"),
        (lambda d: (d / "sequence-000001" / "frame-002.png").unlink(), "frame-002.png is missing"),
        (lambda d: (d / "sequence-000001" / "new.txt").write_text("x"), "does not belong there"),
        (lambda d: (d / "sequence-000002" / FILES).write_text("{}"), "has changed"),
        (lambda d: (d / MANIFEST).write_text("{"), "missing or damaged"),
        (lambda d: (d / MANIFEST).unlink(), "is not whole"),
    ],
)
def test_what_was_changed_is_named(tiny: Path, tmp_path: Path, spoil: object, said: str) -> None:
    folder = copied(tiny, tmp_path / "spoilt")
    spoil(folder)  # type: ignore[operator]
    with pytest.raises(UserError, match=said):
        check(folder)


@pytest.mark.parametrize(
    ("table", "column", "value", "said"),
    [
        ("frames", "normal_n", -0.1, "normal_n is -0.1; allowed: 0 to inf"),
        ("frames", "margin", 1.5, "margin is 1.5; allowed: -0.001 to 1, or NaN"),
        ("frames", "grip_n", math.nan, "grip_n is nan; allowed: -inf to inf"),
        ("frames", "object_mm", math.inf, "object_mm is inf; allowed"),
        ("markers", "overlap", 2.0, r"overlap\[0\] is 2; allowed: 0 to 1, or NaN"),
        ("markers", "node_mu", -0.5, r"node_mu\[0\] is -0.5; allowed: 0 to inf"),
    ],
)
def test_a_value_out_of_its_range_is_named(
    tiny: Path, tmp_path: Path, respelled: Callable[..., None], table: str, column: str,
    value: float, said: str,
) -> None:  # fmt: skip
    folder = copied(tiny, tmp_path / "wrong")
    respelled(folder, table, column, 4, value)
    with pytest.raises(UserError, match=rf"sequence-000000, {table}\.parquet, frame 4: {said}"):
        check(folder)


def test_noisy_datasets_of_before_are_read_and_clean_ones_refused(
    tiny: Path, tmp_path: Path
) -> None:
    """Each recipe named the store; of the two, pictures with noise are what is kept today."""
    folder = copied(tiny, tmp_path / "before")
    recipe = folder / "recipe.toml"
    manifest = json.loads((folder / "manifest.json").read_text("utf-8"))
    for store in ("noisy", "clean"):
        text = f'store = "{store}"\n{(tiny / "recipe.toml").read_text("utf-8")}'
        recipe.write_text(text, "utf-8")
        manifest["files"]["recipe.toml"] = hashlib.sha256(recipe.read_bytes()).hexdigest()
        (folder / "manifest.json").write_text(json.dumps(manifest), "utf-8")
        if store == "noisy":
            assert check(folder) == len(manifest["sequences"])
            assert load_recipe(recipe) == load_recipe(tiny / "recipe.toml")
    with pytest.raises(UserError, match="unknown key store"):
        check(folder)


def test_parts_share_no_object(tiny: Path, tmp_path: Path) -> None:
    made = copied(tiny, tmp_path / "split")
    parts = split(made, {"train": 0.6, "test": 0.4}, by="object")
    every = sorted(name for names in parts.values() for name in names)
    assert every == [sequence_name(k) for k in range(3)]
    assert all(parts.values())
    rows = {sequence_name(row["number"]): row for row in pq.read_table(made / TABLE).to_pylist()}
    objects = [
        {(rows[name]["object.friction"], rows[name]["object.radius_mm"]) for name in names}
        for names in parts.values()
    ]
    assert not objects[0] & objects[1]
    (made / "split.json").unlink()
    with pytest.raises(UserError, match="add up to 1"):
        split(made, {"train": 0.6, "test": 0.3})
    with pytest.raises(UserError, match="differs in 3 of object, too few for 4 parts"):
        split(made, dict.fromkeys("abcd", 0.25), by="object")
    with pytest.raises(UserError, match=r"object.fricton was drawn \(did you mean object.friction"):
        split(made, {"train": 0.6, "test": 0.4}, by="object.fricton")


FORMS: list[dict[str, Any]] = [
    {"object.radius_mm": {"each": [8.0, 20.0, 50.0]}},
    {"object": {"each": [{"radius_mm": r, "stiffness_kpa": 50.0} for r in (8.0, 20.0, 50.0)]}},
]


@pytest.mark.parametrize("form", FORMS, ids=["keys", "tables"])
def test_a_shape_is_in_one_part_unless_it_is_split_by_object(
    tmp_path: Path, form: dict[str, Any], typed: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    """Nine objects that differ in their friction have three shapes; a network would know them."""
    drawn = {key: law for key, law in TINY.draw.items() if not key.startswith("object")}
    drawn |= form | {"object.friction": {"uniform": [0.3, 0.8]}}
    make(replace(TINY, sequences=9, draw=drawn), tmp_path / "data")
    words = ("dataset", "split", tmp_path / "data", "--shares", "train=0.7,test=0.3")
    told = typed(*words).stdout
    # Wide tables are printed in several.
    lines = [line for line in told.splitlines() if line.startswith("object.radius_mm")]
    radii = " ".join(line.removeprefix("object.radius_mm") for line in lines)
    assert sorted(radii.replace(",", " ").split()) == ["20", "50", "8"]
    assert "in several parts" not in told
    assert "of 3 shapes are in several parts: --by shape" in typed(*words, "--by", "object").stdout


def test_a_full_disk_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = Path.write_bytes

    def full(path: Path, data: bytes) -> int:
        if path.name == "frame-003.png":
            raise OSError(28, os.strerror(28))
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(UserError, match="cannot be written: No space left on device"):
        make(TINY, tmp_path / "full")
    assert not list((tmp_path / "full").glob("sequence-*"))
    assert not list((tmp_path / "full").glob(".part-sequence-*"))
    monkeypatch.undo()
    make(TINY, tmp_path / "full", resume=True)
    assert check(tmp_path / "full") == 3


def test_another_recipe_is_refused(tiny: Path, tmp_path: Path) -> None:
    folder = copied(tiny, tmp_path / "other")
    with pytest.raises(UserError, match="holds a dataset of another recipe"):
        make(replace(TINY, seed=1), folder, resume=True)
    with pytest.raises(UserError, match="holds a dataset already; go on with --resume"):
        make(TINY, folder)
    with pytest.raises(UserError, match=r"is not empty; choose another$"):
        make(TINY, tmp_path)
    make(replace(TINY, seed=1, sequences=1), tmp_path / "seed1")
    with pytest.raises(UserError, match=r"another recipe than .*: sequences is 1, and there 3"):
        merge([tiny, tmp_path / "seed1"], tmp_path / "both")
    with pytest.raises(UserError, match="sequence-000000 is in"):
        merge([tiny, folder], tmp_path / "twice")


@pytest.mark.parametrize(
    ("backend", "module", "address"),
    [("dask", "distributed", "tcp://127.0.0.1:9"), ("ray", "ray", "127.0.0.1:9")],
)
def test_a_cluster_that_is_not_there_is_said(
    tmp_path: Path, backend: Backend, module: str, address: str
) -> None:
    pytest.importorskip(module)
    with pytest.raises(UserError, match=f"there is no {backend.title()} cluster"):
        make(TINY, tmp_path / "none", backend=backend, address=address)


def test_an_address_wants_a_cluster(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="--address needs --backend dask or ray"):
        make(TINY, tmp_path / "joblib", address="tcp://127.0.0.1:9")
    pytest.importorskip("distributed")
    with pytest.raises(UserError, match=r"--address nowhere: expected HOST:PORT"):
        make(TINY, tmp_path / "dask", backend="dask", address="nowhere")


@pytest.mark.parametrize(
    ("draw", "said"),
    [
        ({"object.friction": {"uniform": [0.2, 90.0]}}, "draw.object.friction reaches 90"),
        ({"object.frixion": {"uniform": [0.2, 0.9]}}, "frixion"),
        ({"grip_n": {"uniform": [0.0, 1.0]}}, "draw.grip_n reaches 0"),
        ({"grip_n": {"log_uniform": [0.0, 1.0]}}, "log_uniform starts above 0"),
        ({"grip_n": {"about": [1.0]}}, "expected one of uniform, log_uniform, normal, choice"),
        ({"grip_n": {"uniform": [2.0, 1.0]}}, "the range from 2.0 to 1.0 is empty"),
        ({"motion": {"choice": ["drop"]}}, "allowed are press, grasp, slip"),
        ({"motion": {"choice": ["grasp"]}}, "draw.share is needed"),
        (
            {"motion": {"choice": ["press", "slip"]}, "sensor": {"choice": ["thesys"]}},
            "mine.toml: no sensor design 'thesys'",
        ),
        ({"slip_share": {"uniform": [0.5, 2.0]}}, "draw.slip_share reaches 0.5"),
    ],
)
def test_a_recipe_that_leaves_what_can_be_is_refused(
    tmp_path: Path, draw: dict[str, object], said: str
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(tomli_w.dumps({"draw": draw}), encoding="utf-8")
    with pytest.raises(UserError, match=said):
        load_recipe(str(path))


def test_every_shipped_recipe_gives_scenes() -> None:
    for name in recipe_names():
        if name == "objects":  # of the user's own meshes, see test_dome_dataset.py
            continue
        recipe = load_recipe(name)
        for number in range(5):
            scene = scene_of(recipe, number, drawn(recipe, number))
            assert scene.path == "truth"


@pytest.mark.data
def test_what_is_asked_for_beside_is_kept(tmp_path: Path) -> None:
    """Optical flow where a marker rests is the motion of its label."""
    recipe = replace(TINY, sequences=1, truth=("flow", "depth", "masks"))
    make(recipe, tmp_path / "more")
    assert check(tmp_path / "more") == 1
    (one,) = load_sequences(tmp_path / "more")
    truth = np.load(tmp_path / "more" / sequence_name(0) / "truth-006.npz")
    assert truth["depth"].shape == (480, 640)
    assert truth["masks"].shape == (2, 480, 640)
    middle = np.stack([one.markers["projected_x_px"], one.markers["projected_y_px"]], axis=-1)
    middle = middle.reshape(len(middle), 2, -1, 2)
    rest, moved = middle[0], middle[6] - middle[0]
    assert abs(moved).max() > 0.5
    for layer in range(2):
        at = np.rint(rest[layer]).astype(int)
        inside = (abs(at - [320, 240]) < 150).all(axis=1)
        flow = truth["flow"][layer][at[inside, 1], at[inside, 0]]
        np.testing.assert_allclose(flow, moved[layer, inside], atol=0.1)


def test_the_recipe_of_the_documentation_is_one(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "datasets.md").read_text(encoding="utf-8")
    path = tmp_path / "glass.toml"
    path.write_text(text.split("```toml\n")[1].split("```")[0], encoding="utf-8")
    assert load_recipe(str(path)).draw["share"] == {"uniform": [0.0, 0.95]}


def test_a_file_that_may_not_grow_is_said_in_one_sentence(
    tmp_path: Path,
    typed: Callable[..., subprocess.CompletedProcess[str]],
    small_files: Callable[[int], None],
) -> None:
    out = tmp_path / "small"
    small_files(100_000)
    done = typed("dataset", "make", "tiny", "--workers", "1", "--out", out)
    assert done.returncode == 2
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("chromagrip: ")
    assert last.endswith("sequence-000000 cannot be written: File too large")
    assert [path.name for path in out.iterdir()] == ["recipe.toml"]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["dataset"], 0, "usage: chromagrip dataset [-h] {make,check,"),
        (["dataset", "make", "--help"], 0, "usage: chromagrip dataset make "),
        (["dataset", "mend"], 2, "dataset mend: there is make, check"),
        (["dataset", "make", "none", "--out", "x"], 2, "no recipe 'none'; there is benchmark-v2"),
        (["dataset", "make", "tiny", "--out", "x", "--shard", "3/2"], 2, "--shard 3/2: expected"),
        (["dataset", "make", "tiny", "--out", "x", "--n", "0"], 2, "--n 0: expected 1 to"),
        (["dataset", "check", "nowhere"], 2, "nowhere is no dataset; there is no such folder"),
        (["dataset", "check", __file__], 2, "is no dataset; it is a file"),
        (["dataset", "split", "nowhere", "--seed", "-1"], 2, "--seed -1: expected 0 or more"),
        (
            ["dataset", "split", "nowhere", "--shares", "a=0.5,a=1"],
            2,
            "--shares a=0.5,a=1: the part a is given twice",
        ),
        (
            ["dataset", "make", "objects", "--out", "x", "--meshes", "nowhere"],
            2,
            "there is no folder nowhere; give a folder of .stl, ",
        ),
        (["dataset", "split", "nowhere", "--shares", "a"], 2, "--shares a: expected NAME=SHARE"),
    ],
)
def test_the_command_line_answers_in_a_sentence(
    words: list[str],
    code: int,
    said: str,
    typed: Callable[..., subprocess.CompletedProcess[str]],
    tmp_path: Path,
) -> None:
    done = typed(*words)
    assert done.returncode == code
    assert said in done.stdout + done.stderr
    assert not (tmp_path / "x").exists()


def test_words_and_infinity_are_drawn_as_well_as_numbers(tmp_path: Path) -> None:
    draw = {**TINY.draw, "renderer": {"choice": ["painter"]}, "camera.rest_frames": {"choice": [4]}}
    make(replace(TINY, sequences=2, draw=draw), tmp_path / "words")
    rows = pq.read_table(tmp_path / "words" / TABLE).to_pylist()
    assert [(row["renderer"], row["camera.rest_frames"]) for row in rows] == [("painter", 4)] * 2
    radii = {row["object.radius_mm"] for row in rows}
    assert radii <= {float("inf"), 20.0, 8.0}


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda d: (d / sequence_name(1) / "rest.png").unlink(), "rest.png is missing"),
        (lambda d: (d / sequence_name(1)).rename(d / "elsewhere"), "files.json is missing"),
        (lambda d: (d / "recipe.toml").write_text("["), "is not valid TOML"),
    ],
)
def test_a_corrupt_shard_is_not_merged(
    tiny: Path, tmp_path: Path, spoil: object, said: str
) -> None:
    folder = copied(tiny, tmp_path / "spoilt")
    spoil(folder)  # type: ignore[operator]
    with pytest.raises(UserError, match=said):
        merge([folder], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_a_dataset_can_get_more_sequences_but_not_fewer(
    tiny: Path, tmp_path: Path, bytes_of: Digests
) -> None:
    make(replace(TINY, sequences=1), tmp_path / "grown")
    make(TINY, tmp_path / "grown", resume=True)
    assert bytes_of(tmp_path / "grown") == bytes_of(tiny)
    with pytest.raises(UserError, match="is to have 3 sequences; it can get more, not fewer"):
        make(replace(TINY, sequences=2), tmp_path / "grown", resume=True)
    assert check(tmp_path / "grown") == 3


def test_a_folder_is_filled_by_one_run_at_a_time(
    tiny: Path, tmp_path: Path, bytes_of: Digests
) -> None:
    folder = copied(tiny, tmp_path / "grown")
    more, before = replace(TINY, sequences=4), bytes_of(folder)
    with filling(folder), pytest.raises(UserError, match="is being filled by process"):
        make(more, folder, resume=True)
    assert bytes_of(folder) == before
    assert make(more, folder, resume=True)["sequences"].keys() > {"sequence-000002"}


def test_what_other_versions_made_is_not_gone_on_with(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = copied(tiny, tmp_path / "older")
    monkeypatch.setattr(dataset_folder, "made_with", lambda: {"numpy": "9.9"})
    with pytest.raises(UserError, match=r"begun with other versions: .*numpy .*, now 9.9"):
        make(TINY, folder, resume=True)
    monkeypatch.undo()
    assert check(folder) == 3


def test_a_worker_that_is_killed_is_said(tmp_path: Path) -> None:
    def kill(done: int, total: int) -> None:
        if done == 1:
            for child in psutil.Process().children(recursive=True):
                if "LokyProcess" in " ".join(child.cmdline()):
                    child.kill()

    many = replace(TINY, sequences=40)
    with pytest.raises(UserError, match=r"a worker was killed .* go on with --resume"):
        make(many, tmp_path / "lost", workers=2, progress=kill)
    with pytest.raises(UserError, match="is not whole: go on with --resume"):
        check(tmp_path / "lost")


def test_an_empty_shard_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="shard 4/5 of 3 sequences has none"):
        make(TINY, tmp_path / "none", shard=(4, 5))
    assert not (tmp_path / "none").exists()


def test_two_frames_are_a_dataset_too(tmp_path: Path) -> None:
    scene = {**TINY.scene, "duration_s": 0.02, "camera": {"rate_hz": 60.0}}
    make(replace(TINY, sequences=1, scene=scene), tmp_path / "short")
    assert check(tmp_path / "short") == 1


def test_a_sheet_cuts_off_nothing(tiny: Path) -> None:
    """No ink touches the border, for as many sequences as fill a part of a row."""
    sheet = cv2.imread(str(tiny / "contact-sheet.png"))
    assert sheet is not None
    for border in (sheet[:3], sheet[-3:], sheet[:, :3], sheet[:, -3:]):
        assert (border == 255).all()


def test_a_sheet_names_the_shape_of_each_object() -> None:
    box = {
        "object.shape": "box",
        "object.size_mm": [20.0, 20.0, 16.0],
        "object.radius_mm": math.inf,
    }
    assert _shape_name(load_scene("dome-1", box)) == "box"
    assert _shape_name(load_scene("camera-100hz")) == "plane"
    for radius, name in ((12.0, "ball R 12.0 mm"), (-20.0, "hollow R 20.0 mm")):
        assert _shape_name(load_scene("camera-100hz", {"object.radius_mm": radius})) == name


def test_a_sequence_of_a_dome_is_read_as_one_at_its_own_rate(tmp_path: Path) -> None:
    """A read-out of the chain says ±100 % of a silicone dome's forces."""
    draw = {"motion": {"choice": ["press"]}, "object.radius_mm": {"choice": [20.0]}}
    scene = {"body": "dome", "duration_s": 0.2, "camera": {"rate_hz": 60.0}}
    make(replace(TINY, sequences=1, scene=scene, draw=draw), tmp_path / "data", workers=1)
    folder, out = tmp_path / "data/sequence-000000", tmp_path / "out"
    estimate(str(folder / "rest.png"), str(folder), calibration="thesis", out=out)
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["fps"], summary["reconstructor"]) == (60.0, "contact")
    largest = max(pq.read_table(folder / "frames.parquet")["normal_n"].to_pylist())
    assert summary["truth"]["normal_n"]["rms_error"] < 0.1 * largest


def test_truth_stands_next_to_the_estimates_and_changes_none(tiny: Path, tmp_path: Path) -> None:
    sequence, bare = tiny / "sequence-000002", tmp_path / "bare"
    bare.mkdir()
    for picture in sequence.glob("*.png"):
        shutil.copy(picture, bare)
    found = {}
    for folder in (sequence, bare):
        out = tmp_path / f"of-{folder.name}"
        words = str(folder / "rest.png"), str(folder)
        assert estimate(*words, calibration="thesis", fps=60.0, out=out) == 0
        found[folder] = (json.loads((out / "summary.json").read_text()), out / "estimates.parquet")
    summary, table = found[sequence]
    assert summary["reconstructor_doubt"] is None  # a sequence tells its body
    assert "--reconstructor contact" in found[bare][0]["reconstructor_doubt"]
    assert {summary["fps_from"], found[bare][0]["fps_from"]} == {"given"}
    with pytest.raises(UserError, match="is of another sensor than"):
        estimate(*map(str, (sequence / "rest.png", sequence)), calibration="dome-2022")
    assert table.read_bytes() == found[bare][1].read_bytes()
    assert found[bare][0]["truth"] == {}
    frames, read = pq.read_table(sequence / "frames.parquet"), pq.read_table(table)
    for name in ("normal_n", "friction_n"):
        true, value = frames[name].to_numpy(), read[name].to_numpy()
        there = np.isfinite(value)
        told = summary["truth"][name]
        assert told["rms_error"] == pytest.approx(
            np.linalg.norm((true - value)[there]) / there.sum() ** 0.5
        )
        assert told["last"] == true[there][-1]


def test_an_estimate_before_the_end_is_not_called_the_last(
    tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("rest.png", "frame-000.png", "frame-001.png"):
        shutil.copy(tiny / "sequence-000002" / name, tmp_path / name)
    words = {"calibration": "thesis", "fps": 60.0, "overwrite": True, "out": tmp_path / "out"}
    for dark, said in ((False, "at the end"), (True, "in frame 1, the last with an estimate")):
        if dark:
            cv2.imwrite(str(tmp_path / "frame-002.png"), np.zeros((480, 640, 3), np.uint8))
        assert estimate(str(tmp_path / "rest.png"), str(tmp_path), **words) == 0
        assert said in " ".join(capsys.readouterr().out.split())
        summary = json.loads((tmp_path / "out" / "summary.json").read_text("utf-8"))
        assert (summary["frames"], summary["last_estimate"]) == (2 + dark, 1)


def test_parts_come_near_their_shares_of_sequences_though_shapes_are_unevenly_many(
    tmp_path: Path,
) -> None:
    """Radii 8, 8, 8, 8, 20, 50: by shapes alone, halves would have five sequences and one."""
    draw = {"object.radius_mm": {"each": [8.0, 8.0, 8.0, 8.0, 20.0, 50.0]}}
    make(replace(TINY, sequences=6, draw={**TINY.draw, **draw}), tmp_path / "data")
    for seed in range(6):
        parts = split(tmp_path / "data", {"train": 0.5, "test": 0.5}, seed)
        assert sorted(len(names) for names in parts.values()) == [2, 4]
