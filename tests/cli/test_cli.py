"""The command line as it is typed, and as it fails."""

import json
import os
import signal
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import av
import pyarrow.parquet as pq
import pytest

from chromagrip.__main__ import main
from chromagrip.cli.doctor import _caches
from chromagrip.control import GripCommand
from chromagrip.extras import EXTRAS
from chromagrip.loop.run_files import FILES
from chromagrip.render import load_sensor
from chromagrip.render.drawing.gl import gl_problem
from chromagrip.tracking.forces import kept_path

Typed = Callable[..., subprocess.CompletedProcess[str]]
QUICK = ["--set", "duration_s=0.05"]
PROMISED = {
    "controller", "path", "renderer", "final_margin_true", "final_margin_estimated",
    "margin_rmse", "max_pressure_n_per_m", "max_pressure_pitch_n_per_m",
    "lateral_displacement_mm", "rigid_slip_mm", "gross_slip", "max_grip_n", "frames",
    "frames_per_second",
}  # fmt: skip


def test_a_run_leaves_its_folder(tmp_path: Path, typed: Typed) -> None:
    """A filled one is not written over, unless that is asked for; the flags stand in its scene."""
    (tmp_path / "thesis.pdf").write_text("dear to somebody")
    flags = "--controller conservative --path truth --fps 50 --latency 2 --seed 7"
    words = ("grasp", *QUICK, *flags.split(), "--out", str(tmp_path))
    first = typed(*words)
    assert first.returncode == 2
    assert "is not empty; choose another or give --overwrite" in first.stderr
    done = typed(*words, "--overwrite")
    assert done.returncode == 0, done.stderr
    assert "safety margin at the end" in done.stdout
    assert {p.name for p in tmp_path.iterdir()} == {*FILES, "thesis.pdf"}
    assert (tmp_path / "thesis.pdf").read_text() == "dear to somebody"
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary.keys() >= PROMISED | {"versions"}
    assert (summary["frames"], summary["complete"]) == (3, True)
    assert pq.read_metadata(tmp_path / "trace.parquet").num_rows == 3
    with av.open(str(tmp_path / "tactile.mp4")) as video:
        frames = list(video.decode(video=0))
        assert video.streams.video[0].codec_context.pix_fmt == "yuv444p"
    assert (len(frames), frames[0].width, frames[0].height) == (3, 928, 510)  # no picture
    assert (tmp_path / "figure.png").read_bytes()[:4] == b"\x89PNG"
    scene = tomllib.loads((tmp_path / "scene.toml").read_text())
    assert (scene["controller"], scene["seed"], scene["duration_s"]) == ("conservative", 7, 0.05)
    assert (scene["camera"]["rate_hz"], scene["camera"]["latency_frames"]) == (50, 2)


@pytest.mark.loops
def test_json_is_the_summary_alone(tmp_path: Path, typed: Typed) -> None:
    """Through the camera; a folder has the next free name."""
    done = typed("grasp", *QUICK, "--json")
    assert json.loads(done.stdout).keys() >= PROMISED
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "runs/chromatouch-2022-margin-inversion-001").mkdir(parents=True)
    assert typed("grasp", *QUICK).returncode == 0
    out = tmp_path / "runs/chromatouch-2022-margin-inversion-002"
    table = pq.read_table(out / "trace.parquet").to_pydict()
    assert table["normal_true_n"] != table["normal_estimated_n"]


MINE = """
from chromagrip.cli.doctor import _caches
from chromagrip.control import GripCommand

class Mine:
    def reset(self): pass
    def command(self, seen): return GripCommand(force=1.25 if seen.time < 0.05 else -1)
"""


@pytest.mark.loops
def test_a_controller_of_ones_own_lies_where_one_works(tmp_path: Path) -> None:
    """The installed command does not look there by itself, as `python -m` does: hence -P."""
    (tmp_path / "mine.py").write_text(MINE, encoding="utf-8")
    words = ["grasp", "camera-100hz", "--controller", "mine:Mine", "--path", "truth"]
    words += ["--set", "duration_s=0.1"]
    done = subprocess.run(
        [sys.executable, "-P", "-m", "chromagrip", *words],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 2
    assert "chromagrip: controller mine:Mine commanded -1.0 N at t = 0.05 s" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    folder = tmp_path / "runs" / "camera-100hz-mine-Mine-001"
    trace = pq.read_table(folder / "trace.parquet").to_pydict()
    assert trace["grip_n"] == [1.25] * 6


@pytest.fixture(scope="module")
def no_gl() -> str:
    """What the probe says where there is no OpenGL platform of the name that is asked for."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYOPENGL_PLATFORM", "none-such")
        problem = gl_problem.__wrapped__()
    assert problem is not None
    return problem


@pytest.mark.loops
def test_missing_gl_is_one_sentence(
    tmp_path: Path, typed: Typed, no_gl: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("chromagrip.render.drawing.mesh_renderer.gl_problem", lambda: no_gl)
    done = typed("grasp", "--renderer", "pyrender")
    assert done.returncode == 2
    assert "renderer pyrender cannot run here" in done.stderr
    assert "apt-get install" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("number", "code", "told"),
    [
        (signal.SIGINT, 130, "interrupted"),
        pytest.param(signal.SIGTERM, 143, "terminated", marks=pytest.mark.loops),
    ],
)
def test_an_interrupted_run_keeps_what_it_had(
    number: int, code: int, told: str, tmp_path: Path, typed: Typed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interrupted in its midst, by a controller."""
    out = tmp_path / "cut"
    while_it_ran: set[str] = set()

    class Hasty:
        told = 0

        def reset(self) -> None:
            pass

        def command(self, seen: object) -> GripCommand:
            self.told += 1
            if self.told == 6:
                while_it_ran.update(path.name for path in out.iterdir())
                os.kill(os.getpid(), number)
            return GripCommand(force=1.0)

    module = ModuleType("hasty")
    module.__dict__["Hasty"] = Hasty
    monkeypatch.setitem(sys.modules, "hasty", module)
    done = typed("grasp", "--path", "truth", "--controller", "hasty:Hasty", "--out", out)
    assert while_it_ran == {".lock", ".parts", "scene.toml"}  # nothing half-written looks whole
    assert (done.returncode, done.stderr) == (code, f"chromagrip: {told}\n")
    summary = json.loads((out / "summary.json").read_text())
    assert summary["complete"] is False
    frames = summary["frames"]
    assert 0 < frames < 10
    assert pq.read_metadata(out / "trace.parquet").num_rows == frames
    with av.open(str(out / "tactile.mp4")) as video:
        assert len(list(video.decode(video=0))) in (frames, frames - 1)
    assert (out / "figure.png").exists()


def test_a_missing_package_does_not_keep_the_doctor_from_naming_it() -> None:
    """A package that cannot be imported, tyro, on which the command line itself is built.

    Nor can any other large one: the doctor needs none of them.
    """
    absent = ["tyro", "av", "cv2", "matplotlib", "numba", "numpy", "pandas", "pyarrow", "scipy"]
    absent += [extra.module for extra in EXTRAS.values()]
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({absent})); "
        "sys.argv = ['chromagrip', *sys.argv[1:]]; from chromagrip.__main__ import main; main()"
    )
    asked = [sys.executable, "-c", code]
    doctor = subprocess.run([*asked, "doctor"], capture_output=True, text=True, check=False)
    assert doctor.returncode == 1
    assert "tyro" in doctor.stdout
    for name in ("tyro", "matplotlib", "numba"):
        assert f"mend: pip install --force-reinstall '{name}" in doctor.stdout
    other = subprocess.run([*asked, "list", "scenes"], capture_output=True, text=True, check=False)
    assert other.returncode == 2
    assert "`chromagrip doctor` names what mends it" in other.stderr


@pytest.mark.loops
def test_doctor_names_what_is_missing_and_how_to_mend_it(
    typed: Typed, no_gl: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("chromagrip.render.drawing.gl_problem", lambda: no_gl)
    with warnings.catch_warnings(action="ignore"):  # of packages that are imported here first
        done = typed("doctor", start=main)
    assert done.returncode == 0  # GL is optional
    assert "OpenGL for --renderer pyrender: optional, missing" in done.stdout
    assert "mend: sudo apt-get install libegl1" in done.stdout
    assert "numpy" in done.stdout


def test_doctor_names_caches_with_their_size_and_place(
    no_kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(no_kept / "chosen"))
    sizes = {"chromagrip/domes": 3, "chromagrip/readouts": 20, "chosen/chromagrip/kernels": 5}
    for name, megabytes in sizes.items():
        (no_kept / name).mkdir(parents=True)
        (no_kept / name / "kept").write_bytes(bytes(megabytes * 1_000_000))
    named = ("elasticity of domes", "trained read-outs", "compiled kernels")
    assert {(check.name, check.detail) for check in _caches()} >= {
        (f"cache of {words}", f"{size} MB in {no_kept / folder}")
        for words, (folder, size) in zip(named, sizes.items(), strict=True)
    }


@pytest.mark.loops
def test_a_reader_that_leaves_is_no_error_to_tell() -> None:
    """As with `chromagrip bench … | head -1`."""
    read, write = os.pipe()
    os.close(read)
    try:
        done = subprocess.run(
            [sys.executable, "-u", "-m", "chromagrip", "list", "sensors"],
            stdout=write,
            stderr=subprocess.PIPE,
            text=True,
            timeout=120,
            check=False,
        )
    finally:
        os.close(write)
    assert done.returncode == 141
    assert done.stderr == ""


def test_interrupted_trainings_are_found_and_removed(
    typed: Typed, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    begun = kept_path(load_sensor("dome-2022"))
    parts = begun.with_name(f"{begun.name}.parts")
    parts.mkdir(parents=True)
    (parts / "grips.npz").write_bytes(bytes(3_000_000))
    listed = json.loads(typed("list", "readouts", "--json").stdout)
    assert listed["dome-2022, training"].startswith(f"unfinished, 3 MB in {parts};")
    removed = typed("list", "readouts", "--remove-unfinished", "--json")
    assert removed.stderr == f"removed {parts}\n"
    assert not parts.exists()
    assert "dome-2022, training" not in json.loads(removed.stdout)
