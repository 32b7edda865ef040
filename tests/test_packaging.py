"""The wheel and the source distribution, a checkout without links, and the extras."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from collections.abc import Callable
from importlib.metadata import packages_distributions
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import chromagrip
from chromagrip.errors import UserError
from chromagrip.extras import EXTRAS, install_command, missing, need
from chromagrip.links import MEND, STAGES

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
#: Modules that only extras bring.
#: Without torch: tyro trips over a torch that is blocked in this way.
OPTIONAL = ["OpenGL", *(e.module for e in EXTRAS.values() if e.module != "torch")]

#: A clone that has no objects of its own: thousands of files that nothing here reads.
CLONE = ["clone", "-q", "--shared"]

git = shutil.which("git")
needs_git = pytest.mark.skipif(
    git is None or not (ROOT / ".git").exists(), reason="not a git checkout"
)


def build(root: Path, out: Path, kind: str = "wheel") -> Path:
    """Wheel or sdist of a checkout."""
    done = hatchling(root, "-t", kind, "-d", str(out))
    assert done.returncode == 0, done.stderr
    (built,) = out.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return built


def hatchling(root: Path, *arguments: str) -> CompletedProcess[str]:
    command = [sys.executable, "-m", "hatchling", "build", *arguments]
    return subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)


def held(wheel: Path) -> dict[str, int]:
    """Checksum of every file of the package in a wheel."""
    with zipfile.ZipFile(wheel) as files:
        return {f.filename: f.CRC for f in files.infolist() if f.filename.startswith("chromagrip/")}


def files_of_the_package() -> set[str]:
    """Files at their places in the package; those of the stages from the folders at the root."""
    roots = {ROOT / "src/chromagrip": "chromagrip"}
    roots |= {ROOT / stage: f"chromagrip/{stage}" for stage in STAGES}
    found = set()
    for root, name in roots.items():
        for folder, inner, names in os.walk(root):  # follows no links
            inner[:] = [one for one in inner if one != "__pycache__"]
            place = name / Path(folder).relative_to(root)
            found |= {str(place / one) for one in names}
    return found


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(ROOT, tmp_path_factory.mktemp("wheel"))


@pytest.fixture
def unlinked(tmp_path: Path) -> Path:
    """A clone of this repository in which each symbolic link is a text file."""
    clone = tmp_path / "clone"
    command = [str(git), "-c", "core.symlinks=false", *CLONE, str(ROOT), str(clone)]
    subprocess.run(command, check=True, capture_output=True)
    assert (clone / "src/chromagrip/model").is_file()
    return clone


def python(clone: Path, *arguments: str) -> CompletedProcess[str]:
    """Run Python on the code of a clone."""
    return subprocess.run(
        [sys.executable, "-P", *arguments], cwd=clone, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(clone / "src")},
    )  # fmt: skip


@pytest.mark.environments
@needs_git
def test_a_wheel_holds_every_file_from_wherever_it_is_built(
    wheel: Path, unlinked: Path, tmp_path: Path
) -> None:
    """From the checkout, from a clone without links and from the source distribution."""
    assert files_of_the_package() - set(held(wheel)) == set()
    with tarfile.open(build(ROOT, tmp_path, "sdist")) as packed:
        packed.extractall(tmp_path / "sdist", filter="data")
    (unpacked,) = (tmp_path / "sdist").iterdir()
    assert held(build(unpacked, tmp_path / "one")) == held(wheel)
    linked = tmp_path / "linked"
    subprocess.run([str(git), *CLONE, str(ROOT), str(linked)], check=True)
    assert held(build(unlinked, tmp_path / "two")) == held(build(linked, tmp_path / "three"))


@pytest.mark.environments
@needs_git
def test_a_build_without_a_stage_is_refused(unlinked: Path) -> None:
    shutil.rmtree(unlinked / "control")
    for kind in ("wheel", "sdist"):
        done = hatchling(unlinked, "-t", kind)
        sentence = f"cannot build chromagrip: there is no folder {unlinked / 'control'}"
        assert (done.returncode, done.stderr.strip()) == (1, sentence)
    assert not [*unlinked.glob("dist/*")]


@needs_git
def test_a_clone_without_links_says_what_to_do_in_one_sentence(unlinked: Path) -> None:
    done = python(unlinked, "-m", "chromagrip", "grasp", "--json")
    assert done.returncode == 2
    (sentence,) = done.stderr.splitlines()
    assert sentence.startswith("chromagrip: the checkout has no symbolic links")
    assert MEND in sentence
    done = subprocess.run(["./run", "test"], cwd=unlinked, capture_output=True, text=True)
    assert done.returncode == 2
    (sentence,) = done.stderr.splitlines()
    assert sentence.startswith("run: this checkout has no symbolic links")
    assert MEND.split(" (")[0] in sentence


@pytest.mark.environments
@needs_git
def test_the_command_that_is_named_makes_the_links(unlinked: Path) -> None:
    doctor = python(unlinked, "-m", "chromagrip", "doctor")
    assert doctor.returncode == 1
    assert f"mend: {MEND}" in doctor.stdout
    command, _, _ = MEND.partition(" (")
    subprocess.run(command, shell=True, cwd=unlinked, check=True, capture_output=True)
    assert all((unlinked / "src/chromagrip" / stage).is_symlink() for stage in STAGES)
    done = python(unlinked, "-c", "import chromagrip.control; print(chromagrip.control.__file__)")
    assert done.stdout.startswith(str(unlinked))


def test_the_build_and_the_package_say_the_same() -> None:
    found: dict[str, object] = {}
    exec((ROOT / "hatch_build.py").read_text().partition("\n\nclass ")[0], found)
    assert (found["STAGES"], found["MEND"]) == (STAGES, MEND)


def test_version_and_public_names() -> None:
    assert chromagrip.__version__ == PROJECT["version"]
    assert {"run", "load_scene", "__version__", *chromagrip.__all__} <= set(dir(chromagrip))
    for flag in ("--version", "-V"):
        done = python(ROOT, "-m", "chromagrip", flag)
        assert (done.returncode, done.stdout) == (0, f"chromagrip {PROJECT['version']}\n")


#: Runs a command where some modules are not.
WITHOUT = """
import json, sys
sys.modules.update(dict.fromkeys(json.loads(sys.argv.pop(1))))
from chromagrip.__main__ import main
main()
"""
#: Refusals of commands that need an extra.
REFUSED = {
    ("grasp", "--log", "mcap", "--out", "new"): (
        "reading a ROS 2 bag or writing an MCAP log needs the extra `ros`: pip install "
        "'chromagrip[ros]'"
    ),
    ("grasp", "--log", "rerun", "--out", "new"): (
        "writing a run as a Rerun log needs the extra `viz`: pip install 'chromagrip[viz]'"
    ),
    ("grasp", "--renderer", "pyrender", "--json"): (
        "the renderer pyrender needs the extra `gl`: pip install 'chromagrip[gl]'"
    ),
}


def test_every_extra_is_in_the_table_and_the_other_way_round() -> None:
    extras = PROJECT["optional-dependencies"]
    assert {*EXTRAS, "all"} == set(extras)
    assert extras["all"] == [f"chromagrip[{','.join(list(EXTRAS)[:4])}]"]
    distributions = packages_distributions()
    for name, extra in EXTRAS.items():
        wanted = {canonicalize_name(Requirement(text).name) for text in extras[name]}
        brought = {canonicalize_name(one) for one in distributions.get(extra.module, [])}
        assert brought <= wanted


@pytest.mark.environments
def test_without_extras_a_grasp_runs_and_doctor_says_what_is_missing(tmp_path: Path) -> None:
    def without(*words: str) -> list[Any] | dict[str, Any]:
        command = [sys.executable, "-P", "-c", WITHOUT, json.dumps(OPTIONAL), *words, "--json"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
        return json.loads(done.stdout)  # type: ignore[no-any-return]

    for path in ("truth", "camera"):
        assert without("grasp", "--path", path, "--set", "duration_s=0.05")["path"] == path
    checks = {check["name"].split(",")[0]: check for check in without("doctor")}
    for name in EXTRAS:
        assert checks[f"extra {name}"]["state"] == "optional, missing"
        assert checks[f"extra {name}"]["mend"] == install_command(name)


def test_a_package_that_is_there_but_broken_is_a_refusal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert missing("images", "mesh") is None
    assert need("skimage.draw", "images").polygon
    (tmp_path / "mitsuba.py").write_text("import none_such\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "mitsuba", raising=False)
    with pytest.raises(UserError, match=r"mitsuba cannot be imported: No module named 'none_such'"):
        need("mitsuba", "reference")


def test_what_needs_a_missing_extra_is_refused(
    typed: Callable[..., CompletedProcess[str]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for module in OPTIONAL:
        monkeypatch.setitem(sys.modules, module, None)
    for words, sentence in REFUSED.items():
        done = typed(*words)
        assert (done.returncode, done.stderr.strip()) == (2, f"chromagrip: {sentence}")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.environments
def test_a_wheel_alone_grasps_with_the_base_only(wheel: Path, tmp_path: Path) -> None:
    """In a new environment, with the versions of the lock; needs pip and its index."""
    lock = (ROOT / "requirements-dev.lock").read_text()
    pins = re.findall(r"^[\w.-]+==[^\s\\]+(?: ; [^\\]+)?", lock, re.MULTILINE)
    (tmp_path / "pins.txt").write_text("\n".join(pins))
    venv.create(tmp_path / "venv", with_pip=True)
    command = [tmp_path / "venv/bin/python", "-m", "pip", "install", "-q", str(wheel)]
    subprocess.run([*command, "-c", tmp_path / "pins.txt"], check=True)
    clean = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "NUMBA_CACHE_DIR")}

    def run(*words: str) -> CompletedProcess[str]:
        command = [str(tmp_path / "venv/bin/chromagrip"), *words]
        return subprocess.run(
            command, cwd=tmp_path, env=clean, capture_output=True, text=True, check=True
        )

    first = run("grasp", "--json")
    assert json.loads(first.stdout)["path"] == "camera"
    assert first.stderr.startswith("chromagrip: compiling its kernels, once")
    assert run("grasp", "--path", "truth", "--out", "run").stderr.strip() == ""
    run("report", "run")
    run("doctor")
