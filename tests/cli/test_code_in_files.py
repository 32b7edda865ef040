"""Files are data: a `module:Class` in one is shown, and imported only where its module is named."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from chromagrip.by_name import as_in_file, with_allowed
from chromagrip.dataset import load_recipe
from chromagrip.dataset.folder import open_recipe
from chromagrip.errors import UserError
from chromagrip.live.replay import not_repeated
from chromagrip.loop import run
from chromagrip.loop.results.run_folder import read_run
from chromagrip.scene import load_scene
from chromagrip.scene.scene import dump_scene

Typed = Callable[..., CompletedProcess[str]]

#: Leaves a file where it is imported; its class is a controller too.
CODE = """
from pathlib import Path
from chromagrip.control import GripCommand

Path(__file__).with_name("was-imported").touch()

class C:
    def __init__(self, *given): pass
    def reset(self): pass
    def command(self, seen): return GripCommand(force=1.0)
"""
SCENE = """
duration_s = 0.05
path = "{path}"
{key} = "trap.code:C"
"""
KEYS = ("controller", "renderer", "tracker", "reconstructor")


@pytest.fixture(autouse=True)
def _trap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of somebody else, with code, in which a user works."""
    (tmp_path / "trap").mkdir()
    (tmp_path / "trap/code.py").write_text(CODE)
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name in ("trap", "trap.code"):
        monkeypatch.delitem(sys.modules, name, raising=False)


def scene_file(folder: Path, key: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(SCENE.format(path="camera" if key != "controller" else "truth", key=key))
    return path


def imported(folder: Path) -> bool:
    return (folder / "trap/was-imported").exists()


@pytest.mark.parametrize("key", KEYS)
def test_a_grasp_runs_no_code_of_a_scene(key: str, tmp_path: Path, typed: Typed) -> None:
    words = "grasp", "--scene", scene_file(tmp_path, key), "--out", "out"
    done = typed(*words)
    assert done.returncode == 2
    assert "'trap.code:C' stands in a file" in done.stderr
    assert "--allow trap.code" in done.stderr
    assert not imported(tmp_path)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("allowed", ["trap", "trap.code"])
def test_the_module_may_be_named(allowed: str, tmp_path: Path, typed: Typed) -> None:
    scene = scene_file(tmp_path, "controller")
    assert typed("grasp", "--scene", scene, "--allow", allowed, "--json").returncode == 0
    assert imported(tmp_path)


@pytest.mark.parametrize("other", ["tra", "trap.co", "code", "C", "trap.code.more", "os"])
def test_another_module_is_not_enough(other: str, tmp_path: Path, typed: Typed) -> None:
    scene = scene_file(tmp_path, "controller")
    assert typed("grasp", "--scene", scene, "--allow", other, "--json").returncode == 2
    assert not imported(tmp_path)


def test_what_is_typed_is_the_users_own(tmp_path: Path, typed: Typed) -> None:
    path = scene_file(tmp_path, "tracker")
    words = "grasp", "--scene", path, "--path", "truth", "--controller", "trap.code:C", "--json"
    assert typed(*words).returncode == 0
    assert imported(tmp_path)


@pytest.mark.parametrize(
    "words",
    [
        ("render", "--grip", "1", "--scene"),
        ("sweep", "--path", "camera", "--seeds", "1", "--workers", "1", "--scene"),
        ("live", "--seconds", "0.1", "--port", "0"),
        ("plan",),
    ],
)
def test_no_other_command_does(words: tuple[str, ...], tmp_path: Path, typed: Typed) -> None:
    for key in KEYS[:2] if words[0] == "render" else KEYS:
        typed(*words, scene_file(tmp_path, key))
        assert not imported(tmp_path)


def test_a_run_is_shown_and_not_run(tmp_path: Path, typed: Typed) -> None:
    scene = scene_file(tmp_path, "controller")
    words = "grasp", "--scene", scene, "--allow", "trap", "--out", "run"
    assert typed(*words).returncode == 0
    assert "file:" not in (tmp_path / "run/scene.toml").read_text()
    (tmp_path / "trap/was-imported").unlink()
    for name in ("trap", "trap.code"):
        sys.modules.pop(name, None)
    assert typed("report", "run").returncode == 0
    assert "trap.code:C" in (tmp_path / "run/report.html").read_text()
    finished = read_run(tmp_path / "run")
    assert "trap.code:C is code of the folder" in not_repeated(finished)
    assert not imported(tmp_path)
    assert not not_repeated(read_run(tmp_path / "run", allow=("trap",)))


def test_in_python_it_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = str(scene_file(tmp_path, "controller"))
    with pytest.raises(UserError, match=r"allow=\('trap.code',\)"):
        run(path)
    assert not imported(tmp_path)
    run(load_scene(path, allow=("trap",)))
    assert imported(tmp_path)


RECIPES = [
    'scene = {{ {key} = "trap.code:C" }}',
    'draw = {{ {key} = {{ choice = ["trap.code:C"] }} }}',
    '[[cases]]\nname = "a"\nscene = {{ {key} = "trap.code:C" }}',
    '[[cases]]\nname = "a"\ndraw = {{ {key} = {{ each = ["trap.code:C"] }} }}',
    'reading = "trap.code:C"',
]


@pytest.mark.parametrize("text", RECIPES)
def test_a_dataset_runs_no_code_of_a_recipe(text: str, tmp_path: Path, typed: Typed) -> None:
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(f"sequences = 1\n{text.format(key='renderer')}\n")
    done = typed("dataset", "make", recipe, "--out", "data", "--workers", "1")
    said = "no reading" if "reading" in text else "'trap.code:C' stands in a file"
    assert (done.returncode, said in done.stderr) == (2, True)
    assert not imported(tmp_path)


def test_a_dataset_of_ones_own_renderer_goes_on(tmp_path: Path) -> None:
    """What its folder says is compared with the recipe as it was written."""
    path = tmp_path / "recipe.toml"
    path.write_text('scene = { renderer = "trap.code:C" }')
    assert load_recipe(path, allow=("trap",)).scene["renderer"] == "trap.code:C"
    assert open_recipe(tmp_path).scene["renderer"] == "file:trap.code:C"


def test_a_scene_is_written_as_it_was_read(tmp_path: Path) -> None:
    scene = load_scene(str(scene_file(tmp_path, "controller")))
    assert scene.controller == "file:trap.code:C"
    assert 'controller = "trap.code:C"' in dump_scene(scene)


def test_only_names_of_methods_are_marked() -> None:
    values = {
        "description": "a:b",
        "scene": {"tracker": "a:b", "controller_arguments": {"x": "a:b"}},
    }
    marked = with_allowed(values, ())
    assert marked["description"] == "a:b"
    assert marked["scene"] == {"tracker": "file:a:b", "controller_arguments": {"x": "a:b"}}
    assert as_in_file(marked) == values
    assert with_allowed(marked, ())["scene"]["tracker"] == "file:file:a:b"


@pytest.mark.parametrize("flags", [[], ["-P"]])
def test_a_module_beside_a_strangers_files_is_nobodys(flags: list[str], tmp_path: Path) -> None:
    """Optional packages that are looked for are not taken from the working folder."""
    for name in ("rerun", "mcap", "pyarrow", "tomli_w"):
        (tmp_path / f"{name}.py").write_text(CODE)
    (tmp_path / "trap/was-imported").unlink(missing_ok=True)
    words = ["grasp", "--path", "truth", "--set", "duration_s=0.05", "--log", "rerun"]
    subprocess.run(
        [sys.executable, *flags, "-m", "chromagrip", *words],
        cwd=tmp_path, capture_output=True, check=False,
    )  # fmt: skip
    assert not (tmp_path / "was-imported").exists()
