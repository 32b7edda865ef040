"""Kernels that are kept, and what is said where they are not; each in a process of its own."""

import importlib
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from numba.extending import is_jitted

import chromagrip
from chromagrip.kernel_key import kernel_key

KERNEL = """
from chromagrip import compiled

@compiled.njit()
def double(x):
    return 2 * x

compiled.announce()
print(double(1.5), double(4))
"""
ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
COMPILING = "chromagrip: compiling its kernels, once; this takes about a minute"

Run = Callable[..., CompletedProcess[str]]
SLOW = pytest.mark.environments


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """Runs a small kernel that lies in a folder of its own."""
    (tmp_path / "code").mkdir()
    (tmp_path / "code/kernel.py").write_text(KERNEL)

    def start(**changes: object) -> CompletedProcess[str]:
        changed = {k: str(v) for k, v in ({"XDG_CACHE_HOME": tmp_path / "user"} | changes).items()}
        command = [sys.executable, "-P", str(tmp_path / "code/kernel.py")]
        done = subprocess.run(
            command, env=ENVIRONMENT | changed, capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stdout) == (0, "3.0 8\n"), done.stderr
        return done

    return start


def kept(folder: Path) -> int:
    return len(list(folder.rglob("*.nbc")))


@SLOW
def test_compiling_is_said_at_the_first_run_only(run: Run, tmp_path: Path) -> None:
    kernel = tmp_path / "code/kernel.py"
    kernel.write_text(kernel.read_text() + "import sys\nprint(compiled.cold(), file=sys.stderr)\n")
    with ThreadPoolExecutor() as pool:  # two processes may compile at once
        said = {done.stderr for done in pool.map(lambda _: run(), range(2))}
    assert f"{COMPILING}\nTrue\n" in said
    assert run().stderr == "False\n"
    assert kept(tmp_path / "code/__pycache__") == 2  # a float and an integer
    assert not [*tmp_path.rglob("*.part")]
    assert not (tmp_path / "user").exists()


@SLOW
def test_where_kernels_are_kept_and_what_is_said(run: Run, tmp_path: Path) -> None:
    """In a folder of one's choice, in the user's if the package cannot be written, or nowhere."""
    for words in (f"{COMPILING}\n", ""):
        assert run(NUMBA_CACHE_DIR=tmp_path / "chosen").stderr == words
    assert kept(tmp_path / "chosen/chromagrip/kernels") == 2
    lost = tmp_path / "code/kernel.py"  # a file, which nobody can write into as a folder
    for _ in range(2):
        (sentence,) = run(NUMBA_CACHE_DIR=lost).stderr.splitlines()
        assert f"NUMBA_CACHE_DIR={lost} cannot be written" in sentence
    (tmp_path / "code/__pycache__").write_text("no folder")
    for words in (f"{COMPILING} (they are kept in {tmp_path / 'user/chromagrip'}, ", ""):
        assert run().stderr.startswith(words)
    assert kept(tmp_path / "user") == 2
    (sentence,) = run(XDG_CACHE_HOME=lost).stderr.splitlines()
    assert "cannot be written, so the kernels are compiled at each start" in sentence


@SLOW
def test_what_nobody_used_for_a_week_is_removed(run: Run, tmp_path: Path) -> None:
    run()
    home, now, day = tmp_path / "code/__pycache__/kernels", time.time(), 86400.0
    used = {*home.iterdir()}
    for path in used:
        os.utime(path, (now - 6.0 * day,) * 2)
    assert run().stderr == ""
    assert all(path.stat().st_mtime > now - day for path in used)  # the use is noted
    idle, former = home / "idle.nbc", home.parent / "kernels-0123456789abcdef"
    idle.touch()
    former.mkdir()
    for path in (idle, former):
        os.utime(path, (now - 8.0 * day,) * 2)
    (tmp_path / "code/kernel.py").write_text(KERNEL.replace("2 * x", "x + x"))
    run()
    assert [*home.parent.iterdir()] == [home]
    assert used < {*home.iterdir()}
    assert kept(home) == 4


NEAR = """
import numpy as np
from chromagrip import compiled
import far
from far import PAIRS, Pair, b, twice
SHARE = 3.0
TABLE = np.array([2.0, 5.0])
@compiled.njit()
def a(x): return b(x) + 1.0
@compiled.njit()
def c(x):
    "Multiply."
    return SHARE * x
@compiled.njit()
def by_array(x): return TABLE[1] + PAIRS[0].second * x
@compiled.njit()
def by_module(x): return far.d(x)
def enclosed(kernel, summand):
    @compiled.njit()
    def by_closure(x): return kernel(x) + summand
    return by_closure
by_closure = enclosed(far.d, 100.0)
@compiled.njit()
def early(x): return late(x)
@compiled.njit()
def late(x): return x - 5.0
@compiled.njit()
def by_intrinsic(x): return twice(x)
@compiled.njit()
def by_fields(pair): return pair[0] - 2.0 * pair.first
"""
FAR = """
from typing import NamedTuple
from chromagrip import compiled
from numba.extending import intrinsic
class Pair(NamedTuple):
    first: float
    second: float
PAIRS = (Pair(1.0, 2.0),)
@compiled.njit()
def b(x, by=2.0): return by * x
@compiled.njit()
def d(x): return x / 4.0
def added(builder, x, y):
    return builder.fadd(x, y)
@intrinsic
def twice(context, x):
    def write(context, builder, signature, arguments):
        return added(builder, arguments[0], arguments[0])
    return x(x), write
"""
MAIN = """
import json, sys
from pathlib import Path
sys.path.insert(0, str(Path(__file__).parent))
from numba.core import event
with event.install_recorder("numba:compile") as recorder:
    import near
    from near import *
    from far import d
    results = {k.__name__: k(2.0) for k in (
        a, b, c, by_array, by_module, by_closure, d, early, late, by_intrinsic)}
    results["by_fields"] = by_fields(Pair(2.0, 7.0))
names = [e.data["dispatcher"].py_func.__name__ for _, e in recorder.buffer if e.is_start]
print(json.dumps([results, sorted(names)]))
"""
RESULTS = {
    "a": 5.0, "b": 4.0, "c": 6.0, "by_array": 9.0, "by_module": 0.5, "by_closure": 100.5, "d": 0.5,
    "early": -3.0, "late": -3.0, "by_intrinsic": 4.0, "by_fields": -2.0,
}  # fmt: skip


class Package:
    """Kernels in two files, which are compiled once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        assert self.run() == (RESULTS, sorted(RESULTS))

    def run(
        self, replaced: dict[str, str] | None = None, **changes: str
    ) -> tuple[dict[str, float], list[str]]:
        """Results of all kernels, and which are compiled, where some texts are replaced."""
        sources = {"near.py": NEAR, "far.py": FAR, "main.py": MAIN}
        for old, new in (replaced or {}).items():
            assert "".join(sources.values()).count(old) == 1, old
            sources = {name: text.replace(old, new) for name, text in sources.items()}
        for name, text in sources.items():
            (self.folder / name).write_text(text)
        command = [sys.executable, "-P", "-B", str(self.folder / "main.py")]
        done = subprocess.run(
            command, env=ENVIRONMENT | changes, capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, ""), done.stderr
        results, names = json.loads(done.stdout)
        return results, names


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Package:
    return Package(tmp_path_factory.mktemp("package"))


#: Changes of the sources, and of results; those of a group have no result in common.
CHANGES: dict[str, tuple[dict[str, str], dict[str, float]]] = {
    "file, array, closure, below": (
        {"return by * x": "return by + by * x", "[2.0, 5.0]": "[2.0, 6.0]", "100.0": "200.0",
         "x - 5.0": "x - 6.0"},
        {"a": 7.0, "b": 6.0, "by_array": 10.0, "by_closure": 200.5, "early": -4.0, "late": -4.0},
    ),
    "caller, number, tuple, helper": (
        {"b(x) + 1.0": "b(x) - 1.0", "SHARE = 3.0": "SHARE = 3.5", "Pair(1.0, 2.0),":
         "Pair(1.0, 3.0),", "builder.fadd": "builder.fsub"},
        {"a": 3.0, "c": 7.0, "by_array": 11.0, "by_intrinsic": 0.0},
    ),
    "default, module, intrinsic, fields": (
        {"by=2.0": "by=3.0", "x / 4.0": "x / 8.0",
         "first: float\n    second: float": "second: float\n    first: float",
         "arguments[0], arguments[0])": "arguments[0], arguments[0].type(1.0))"},
        {"a": 7.0, "b": 6.0, "d": 0.25, "by_module": 0.25, "by_closure": 100.25,
         "by_intrinsic": 3.0, "by_array": 7.0, "by_fields": -12.0},
    ),
}  # fmt: skip
QUICK, *MORE = CHANGES


@pytest.mark.parametrize("group", [QUICK, *(pytest.param(each, marks=SLOW) for each in MORE)])
def test_changes_compile_what_reaches_them(package: Package, group: str) -> None:
    replaced, changed = CHANGES[group]
    assert package.run(replaced) == (RESULTS | changed, sorted(changed))


@pytest.mark.environments
def test_what_is_no_code_compiles_nothing(package: Package) -> None:
    nothing = {
        "\nSHARE": "\n\n# A share.\nSHARE",
        "Multiply": "Multiply by it",
        "def d(x):": "def d(x: float) -> float:",
    }
    assert package.run(nothing) == (RESULTS, [])


@SLOW
def test_checked_bounds_are_other_code(package: Package) -> None:
    assert package.run(NUMBA_BOUNDSCHECK="1") == (RESULTS, sorted(RESULTS))


@SLOW
def test_kernels_run_as_python_where_numba_is_told_so() -> None:
    script = """
import numpy as np
from chromagrip.model.kernels.dome.turn_kernels import turned
print(turned(np.eye(3), np.zeros(3)).trace())
"""
    done = subprocess.run(
        [sys.executable, "-P", "-c", script],
        env={**ENVIRONMENT, "NUMBA_DISABLE_JIT": "1"}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout == "3.0\n"


@SLOW
def test_what_has_no_digest_is_compiled_at_each_start(tmp_path: Path) -> None:
    script = tmp_path / "kernel.py"
    script.write_text("""
import ctypes, math
from chromagrip import compiled
root = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(math.sqrt)
@compiled.njit()
def by_address(x): return root(x)
@compiled.njit()
def triple(x): return 3.0 * x
@compiled.njit()
def by_argument(kernel, x): return kernel(x)
print(by_address(4.0), by_argument(triple, 4.0))
""")
    done = subprocess.run(
        [sys.executable, "-P", str(script)],
        env=ENVIRONMENT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout == "2.0 12.0\n"
    for name in ("by_address", "by_argument"):
        assert f"__main__.{name} is compiled at each start" in done.stderr
    assert "triple is" not in done.stderr
    (path,) = tmp_path.rglob("*.nbc")
    assert path.name.startswith("__main__.triple-")


def test_every_kernel_has_a_key_that_sees_all() -> None:
    package, count = Path(chromagrip.__path__[0]), 0
    for folder, _, names in os.walk(package, followlinks=True):
        for path in [Path(folder) / name for name in names if name.endswith(".py")]:
            text = path.read_text()
            if path.name != "kernel_key.py":
                # What `overload` and its like register has no name in a kernel.
                assert not re.search(r"numba.extending import (?!intrinsic\n)", text), path
                assert "numba.extending." not in text, path
            if "njit(" in text and path.name != "compiled.py":
                place = path.relative_to(package).with_suffix("")
                module = importlib.import_module(".".join(("chromagrip", *place.parts)))
                kernels = [value for value in vars(module).values() if is_jitted(value)]
                assert all(len(kernel_key(kernel)) == 64 for kernel in kernels)
                count += len(kernels)
    assert count > 200
