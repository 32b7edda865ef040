"""Files are data: a `module:Class` in one is shown, and imported only where its module is named."""

import shutil
import subprocess
import sys
from pathlib import Path

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

from .judged import Judge

WRITTEN = Path(__file__).parents[2] / "fixtures/written-before/chain"
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
SCENE = 'duration_s = 0.05\npath = "{path}"\n{key} = "trap.code:C"\n'
STANDS = "'trap.code:C' stands in a file"


@pytest.fixture(autouse=True)
def _trap(judged: Judge, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of somebody else, with code, in which a user works."""
    (judged.place / "trap").mkdir()
    (judged.place / "trap/code.py").write_text(CODE)
    monkeypatch.setattr(sys, "path", [str(judged.place), *sys.path])
    forget()


def forget() -> None:
    for name in ("trap", "trap.code"):
        sys.modules.pop(name, None)


def scene_file(key: str) -> str:
    path = "camera" if key != "controller" else "truth"
    Path("scene.toml").write_text(SCENE.format(path=path, key=key))
    return "scene.toml"


def imported() -> bool:
    return Path("trap/was-imported").exists()


GRASP = ("grasp", "--out", "out", "--scene")


@pytest.mark.parametrize(
    ("words", "key"),
    [
        *((GRASP, key) for key in ("controller", "renderer", "tracker", "reconstructor")),
        pytest.param(("render", "--grip", "1", "--scene"), "renderer", marks=pytest.mark.loops),
        pytest.param(("sweep", "--seeds", "1", "--workers", "1", "--scene"), "tracker",
                     marks=pytest.mark.loops),
        (("live", "--seconds", "0.1"), "controller"),
        (("plan",), "reconstructor"),
    ],
)  # fmt: skip
def test_no_command_runs_the_code_of_a_scene(
    judged: Judge, words: tuple[str, ...], key: str
) -> None:
    """Nor with another module allowed; what is imported would leave a file."""
    name = scene_file(key)
    for allowed in ((), ("--allow", "trap.co")):
        left = words[0] == "render"  # issue 81: an empty folder
        done = judged.command(*words, name, *allowed, makes=("runs",), leaves=left)
        assert done.returncode == (0 if words[0] in ("plan", "sweep") else 2)
        assert words[0] == "plan" or "--allow trap.code" in done.stdout + done.stderr


@pytest.mark.parametrize("other", ["tra", "trap.co", "code", "C", "trap.code.more", "os", "trap"])
def test_a_module_allows_itself_and_those_below(other: str) -> None:
    marked = with_allowed({"scene": {"tracker": "trap.code:C"}}, (other,))
    assert marked["scene"]["tracker"] == ("" if other == "trap" else "file:") + "trap.code:C"


def test_what_is_allowed_or_typed_is_the_users_own() -> None:
    with pytest.raises(UserError, match=r"allow=\('trap.code',\)"):
        run(scene_file("controller"))
    assert not imported()
    run(load_scene("scene.toml", allow=("trap.code",)))
    assert imported()
    Path("trap/was-imported").unlink()
    forget()
    run(load_scene(scene_file("tracker"), {"path": "truth", "controller": "trap.code:C"}))
    assert imported()


def test_a_run_is_shown_and_not_run(judged: Judge) -> None:
    shutil.copytree(WRITTEN, "given")
    for path in (Path("given/scene.toml"), Path("given/summary.json")):
        path.write_text(path.read_text().replace('"margin-inversion"', '"trap.code:C"'))
    assert judged.typed("report", "given").returncode == 0
    assert "trap.code:C" in Path("given/report.html").read_text()
    assert "trap.code:C is code of the folder" in not_repeated(read_run(Path("given")))
    assert not imported()
    assert not not_repeated(read_run(Path("given"), allow=("trap",)))


@pytest.mark.parametrize(
    "text",
    [
        'scene = { renderer = "trap.code:C" }',
        '[[cases]]\nname = "a"\ndraw = { renderer = { each = ["trap.code:C"] } }',
        'reading = "trap.code:C"',
    ],
)
def test_a_dataset_runs_no_code_of_a_recipe(judged: Judge, text: str) -> None:
    Path("recipe.toml").write_text(f"sequences = 1\n{text}\n")
    words = ("dataset", "make", "recipe.toml", "--out", "data", "--workers", "1")
    told = "no reading" if "reading" in text else STANDS
    judged.command(*words, names=told, makes=("data",), leaves=True)  # issue 81: recipe.toml
    assert judged.refused == 1


def test_names_are_written_as_they_were_read() -> None:
    """What a dataset's folder says is compared with the recipe as it was written."""
    loaded = load_scene(scene_file("controller"))
    assert loaded.controller == "file:trap.code:C"
    assert 'controller = "trap.code:C"' in dump_scene(loaded)
    Path("recipe.toml").write_text('scene = { renderer = "trap.code:C" }')
    assert load_recipe("recipe.toml", allow=("trap",)).scene["renderer"] == "trap.code:C"
    assert open_recipe(Path()).scene["renderer"] == "file:trap.code:C"
    values = {
        "description": "a:b",
        "scene": {"tracker": "a:b", "controller_arguments": {"x": "a:b"}},
    }
    marked = with_allowed(values, ())
    assert marked["description"] == "a:b"
    assert marked["scene"] == {"tracker": "file:a:b", "controller_arguments": {"x": "a:b"}}
    assert as_in_file(marked) == values
    assert with_allowed(marked, ())["scene"]["tracker"] == "file:file:a:b"


@pytest.mark.loops
def test_a_module_beside_a_strangers_files_is_nobodys() -> None:
    """Optional packages that are looked for are not taken from the working folder."""
    for name in ("rerun", "mcap", "pyarrow", "tomli_w"):
        Path(f"{name}.py").write_text(CODE)
    words = ["grasp", "--path", "truth", "--set", "duration_s=0.05", "--log", "rerun"]
    subprocess.run([sys.executable, "-m", "chromagrip", *words], capture_output=True, check=False)
    assert not Path("was-imported").exists()
