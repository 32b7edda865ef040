"""Which room may import which, and that no import goes round in a circle."""

import ast
import graphlib
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import chromagrip

ROOT = Path(__file__).parents[1]
PACKAGE = Path(chromagrip.__path__[0])
GROUND = ["arguments", "by_name", "compiled", "errors", "extras", "folders", "kept_arrays"]
GROUND += ["kernel_key", "links", "strange_files", "stored_pictures", "strict_toml", "thesis"]
#: Rooms from the lowest to the highest, each with the rooms that it may import. The modules of the
#: ground floor may be imported everywhere and import nothing of ours but each other.
MAY_IMPORT = {
    "model": "",
    "render": "model",
    "tracking": "model render",
    "control": "model",
    "sources": "render",
    "output": "model render tracking sources",
    "publish": "model render control output sources",
    "scene": "model render tracking control output",
    "sensing": "model render tracking control output sources scene",
    "loop": "model render tracking control output sources scene sensing",
    "pictures": "model render tracking control output sources publish scene sensing loop",
    "calibrate": "model render tracking control output sources scene sensing loop pictures",
    "dataset": "model render tracking control output sources scene sensing loop",
    "gym": "model render tracking control output sources scene sensing loop",
    "outside": "model render tracking control output sources scene sensing loop",
    "live": "model render tracking control output sources scene sensing loop pictures outside",
    "measure": "model render tracking control output sources scene sensing loop pictures calibrate "
    "dataset outside",
    "cli": "model render tracking control output sources scene sensing loop pictures calibrate "
    "dataset measure outside live",
}
#: Modules beside the rooms: the entry points.
DOORS = {
    "__init__": "model scene sensing loop gym",
    "__main__": "cli output",
    "mujoco": "model render sensing",
}
STAGES = ("model", "render", "tracking", "control")
#: Largest number of lines in a function.
MOST_LINES = 60
#: Functions that are longer, each for a reason: a kernel's caller with all its arrays, and front
#: doors whose parameters and their description fill most lines.
LONG_FUNCTIONS = {
    "loop.poses.folder.render_poses",
    "mujoco.attach",
    "pictures.estimate.estimate_source",
}


@cache
def modules() -> dict[str, Path]:
    """File of every module, by its name without `chromagrip.`."""
    found = {}
    for folder, inner, names in os.walk(PACKAGE, followlinks=True):
        inner[:] = sorted(name for name in inner if name != "__pycache__")
        for name in [name for name in sorted(names) if name.endswith(".py")]:
            place = (Path(folder) / name).relative_to(PACKAGE).with_suffix("")
            found[".".join(place.parts)] = Path(folder) / name
    return found


@cache
def nodes(module: str) -> list[ast.AST]:
    """All nodes of a module's syntax tree, the module first."""
    return [*ast.walk(ast.parse(modules()[module].read_text(encoding="utf-8")))]


def imports(module: str) -> Iterator[tuple[str, ast.ImportFrom]]:
    """Modules of ours that a module imports, wherever it does so."""
    for node in nodes(module):
        if isinstance(node, ast.Import):
            assert not any(a.name.split(".")[0] == "chromagrip" for a in node.names), module
        if not isinstance(node, ast.ImportFrom):
            continue
        if not node.level:
            bare = (node.module or "").split(".")[0]
            assert bare not in {*MAY_IMPORT, *GROUND, "chromagrip"}, f"{module}: import relatively"
            continue
        package = module.split(".")[:-1]
        base = package[: len(package) - node.level + 1] + (node.module or "").split(".")
        base = [part for part in base if part]
        for alias in node.names:
            full = ".".join([*base, alias.name])
            yield (full if is_module(full) else ".".join(base)), node


def is_module(name: str) -> bool:
    return name in modules() or f"{name}.__init__" in modules()


def room(module: str) -> str:
    return module.split(".")[0]


def test_every_room_is_in_the_table() -> None:
    assert {room(name) for name in modules()} == {*MAY_IMPORT, *GROUND, *DOORS}


def test_rooms_import_only_what_they_may() -> None:
    for module in modules():
        name = room(module)
        allowed = {name, "", *GROUND}
        if name not in GROUND:
            allowed |= {*(MAY_IMPORT.get(name) or DOORS.get(name, "")).split()}
        for target, _ in imports(module):
            assert room(target) in allowed, f"{module} imports {target}"


def test_no_import_goes_round_in_a_circle() -> None:
    def key(name: str) -> str:
        return name if name in modules() else f"{name}.__init__"

    arrows = {
        module: {key(target) for target, _ in imports(module) if key(target) in modules()}
        for module in modules()
    }
    graphlib.TopologicalSorter(arrows).prepare()  # raises CycleError, which names the circle


def test_stages_are_entered_through_their_faces() -> None:
    """From outside, a stage's names are imported from it or from one of its inner packages.

    Other rooms are entered through their modules: most of these load heavy libraries, and only
    where they are used. No private name crosses the border of a room.
    """
    for module in modules():
        for target, node in imports(module):
            if room(target) in ("", room(module)):
                continue
            assert not any(alias.name.startswith("_") for alias in node.names), module
            if room(target) in STAGES and f"{target}.__init__" not in modules():
                face, _, name = target.rpartition(".")
                # A function may have the name of its module, such as render.outlines.
                assert [alias.name for alias in node.names if alias.name == name], (
                    f"{module} imports from {target}; import from {face}"
                )


def test_functions_are_short() -> None:
    """Kernels aside, and commands of the command line, whose options fill most of their lines."""
    long = set()
    for module in modules():
        if "kernels" in module or room(module) == "cli":
            continue
        for node in nodes(module):
            if (
                isinstance(node, ast.FunctionDef)
                and (node.end_lineno or node.lineno) - node.lineno >= MOST_LINES
            ):
                long.add(f"{module}.{node.name}")
    assert long == LONG_FUNCTIONS


def test_control_knows_nothing_of_the_model_but_its_force_field() -> None:
    for module in modules():
        for target, node in imports(module) if room(module) == "control" else ():
            if room(target) == "model":
                assert [alias.name for alias in node.names] == ["ForceField"]


def test_estimators_are_never_given_the_truth() -> None:
    """Tracking may use the bodies' calibration; not the object, its state or its contact forces.

    What reads a dome, or follows a chain, makes contacts of its own, with objects of its own, to
    compare with a picture.
    """
    allowed = {"REFERENCE_NODES", "Fingertip", "SpringLaw", "chain_compliance", "chain_forces"}
    allowed |= {"ForceField", "FrictionReading", "LoadPlane"}  # what they answer …
    allowed |= {"margin_within", "torsion"}  # … and what follows from it alone
    supposed = {"Dome", "PosedContact", "PosedContacts", "together", "SoftBody", "Solid"}
    supposed |= {"lattice", "quadric", "rotation_of"}
    followed = {"Copies", "Ensemble", "copies_of", "place_many", "rest_ensemble"}
    for module in modules():
        more = supposed if module.startswith("tracking.forces.dome.") else set()
        more = more | (followed if module == "tracking.forces.chain.way_filter" else set())
        for target, node in imports(module) if room(module) == "tracking" else ():
            if room(target) == "model" and not target.startswith("model.kernels"):
                assert {alias.name for alias in node.names} <= allowed | more, module


@pytest.mark.environments
def test_nothing_heavy_is_imported_before_it_is_used() -> None:
    """By one process that imports one after another: what one brings, the next ones have too."""
    heavy = {
        "chromagrip.model": "cv2 OpenGL pyrender matplotlib av pandas pyarrow",
        "chromagrip.control": "cv2 OpenGL pyrender matplotlib av pandas pyarrow",
        "chromagrip.tracking": "OpenGL pyrender matplotlib av pandas pyarrow",
        "chromagrip.cli.app": "OpenGL pyrender matplotlib av pandas pyarrow",
        "chromagrip.loop.run": "OpenGL pyrender av pandas pyarrow",
    }
    code = "import sys\n" + "\n".join(
        f"import {module}; print(*({set(names.split())!r} & set(sys.modules)))"
        for module, names in heavy.items()
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    found = dict(zip(heavy, done.stdout.splitlines(), strict=True))
    assert found == dict.fromkeys(heavy, "")


def test_every_module_says_what_it_is_for() -> None:
    for module in modules():
        assert ast.get_docstring(nodes(module)[0]), module


def test_the_product_calls_each_library_that_it_promises() -> None:
    """By an import of its own, or by `need`, which imports what an extra brings."""
    called = set()
    for node in [node for module in modules() for node in nodes(module)]:
        if isinstance(node, ast.Import):
            called |= {alias.name for alias in node.names}
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "need":
            called |= {arg.value for arg in node.args[:1] if isinstance(arg, ast.Constant)}
    assert {"cv2", "pyrender", "skimage", "trimesh"} <= {str(name).split(".")[0] for name in called}
