"""Arrows point one way: model ← render ← tracking, control ← model; chromagrip wires them."""

import ast
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import chromagrip

ROOT = Path(__file__).parents[2]
PACKAGE = Path(chromagrip.__path__[0])
ALLOWED = {
    "model": {"model"},
    "render": {"render", "model"},
    "tracking": {"tracking", "render", "model"},
    "control": {"control", "model"},
}


def modules(folder: str) -> list[Path]:
    return sorted((PACKAGE / folder).glob("*.py"))


def imported_folders(path: Path, folder: str) -> set[str]:
    """Folders of ours that a module imports, relative imports resolved."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level == 1:
            found.add(folder)
        elif isinstance(node, ast.ImportFrom) and node.level == 2:
            found.add((node.module or "").split(".")[0])
        elif isinstance(node, ast.ImportFrom | ast.Import):
            names = (
                [node.module or ""]
                if isinstance(node, ast.ImportFrom)
                else [alias.name for alias in node.names]
            )
            bare = {name.split(".")[0] for name in names}
            assert not bare & {*ALLOWED, "chromagrip"}, f"{path} does not import relatively"
    return found


@pytest.mark.parametrize("folder", ALLOWED)
def test_folders_import_only_what_they_may(folder: str) -> None:
    assert modules(folder), f"{PACKAGE / folder} is empty: checked out without symbolic links?"
    for path in modules(folder):
        assert imported_folders(path, folder) <= ALLOWED[folder], path


def test_control_knows_nothing_of_the_model_but_its_force_field() -> None:
    for path in modules("control"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == 2:
                assert [alias.name for alias in node.names] == ["ForceField"]


def test_estimators_are_never_given_the_truth() -> None:
    """Tracking may use the chain's calibration; not the object, its state or its contact forces."""
    allowed = {"REFERENCE_NODES", "Fingertip", "SpringLaw", "chain_compliance", "chain_forces"}
    allowed |= {"ForceField", "FrictionReading"}  # what they answer
    for path in modules("tracking"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == 2 and node.module == "model":
                assert {alias.name for alias in node.names} <= allowed, path


@pytest.mark.parametrize(
    ("module", "heavy"),
    [
        ("chromagrip.model", "cv2 OpenGL pyrender matplotlib av pyarrow"),
        ("chromagrip.control", "cv2 OpenGL pyrender matplotlib av pyarrow"),
        ("chromagrip.tracking", "OpenGL pyrender matplotlib av pyarrow"),
        ("chromagrip.run_folder", "OpenGL pyrender"),
    ],
)
def test_nothing_heavy_is_imported_before_it_is_used(module: str, heavy: str) -> None:
    code = f"import sys, {module}; print(*({set(heavy.split())!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_every_module_says_what_it_is_for() -> None:
    for path in [*PACKAGE.glob("*.py"), *(p for f in ALLOWED for p in modules(f))]:
        assert ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))), path


def test_the_wheel_holds_every_module(tmp_path: Path) -> None:
    pytest.importorskip("hatchling", reason="hatchling is not installed")
    if not (ROOT / "pyproject.toml").is_file():
        pytest.skip("not a checkout")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (wheel,) = tmp_path.glob("*.whl")
    held = set(zipfile.ZipFile(wheel).namelist())
    for folder in ("", *ALLOWED):
        for path in (PACKAGE / folder).glob("*.py"):
            assert f"chromagrip/{folder}/{path.name}".replace("//", "/") in held
    assert "chromagrip/scenes/camera-100hz.toml" in held
    assert "chromagrip/render/designs/thesis.toml" in held
    assert "chromagrip/thesis/printed.toml" in held
