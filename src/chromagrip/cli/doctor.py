"""What this machine lacks, the command that mends it, and the caches that it has.

Nothing but the standard library is imported before it is checked: a missing part must not keep the
doctor from naming it.
"""

import json
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib import import_module
from importlib.metadata import packages_distributions, requires, version
from importlib.util import find_spec
from pathlib import Path

from .. import links
from ..extras import EXTRAS, install_command
from ..folders import user_cache
from ..output import opencv

OK = "ok"
MISSING = "missing"
OPTIONAL = "optional, missing"
OTHER = "another one"
BROKEN = "broken"
#: What the user's cache holds, by folder; what is removed is made again when it is needed.
_CACHES = {
    "kernels": "compiled kernels",
    "domes": "elasticity of domes",
    "meshes": "distances from meshes",
    "readouts": "trained read-outs",
    "datasets": "datasets from the network",
}


@dataclass(frozen=True, kw_only=True)
class Check:
    """One part: its name, one of the states above, and if not OK the reason and the mend."""

    name: str
    state: str = OK
    detail: str = ""
    mend: str = ""


def report(*, json_only: bool = False) -> int:
    """Print every check; exit code 1 if a required part is missing or any part is broken."""
    python = ".".join(map(str, sys.version_info[:3]))
    checks = [Check(name=f"Python {python}"), _stages(), *_base(), *_extras(), *_caches()]
    if json_only:
        print(json.dumps([asdict(check) for check in checks]))
    else:
        for check in checks:
            print(f"{check.name}: {check.state}{check.detail and f' ({check.detail})'}")
            if check.mend:
                print(f"    mend: {check.mend}")
    return int(any(check.state in (MISSING, BROKEN) for check in checks))


def _stages() -> Check:
    name = f"package folders {', '.join(links.STAGES)}"
    if links.problem() is None:
        return Check(name=name)
    return Check(name=name, state=MISSING, detail="no symbolic links", mend=links.MEND)


def _base() -> Iterator[Check]:
    """Check each package that is always installed."""
    modules: dict[str, list[str]] = {}
    for module, distributions in packages_distributions().items():
        for name in distributions:
            modules.setdefault(name.lower().replace("_", "-"), []).append(module)
    for line in requires("chromagrip") or []:
        requirement, _, marker = line.partition(";")
        if "extra ==" in marker:
            continue
        name = requirement.strip()
        for sign in "<>=!~[ ":
            name = name.split(sign)[0]
        mend = f"pip install --force-reinstall '{requirement.strip()}'"
        if name not in modules:
            yield Check(name=name, state=MISSING, detail="not installed", mend=mend)
            continue
        name_and_version = f"{name} {version(name)}"
        if name == opencv.OURS and (overwritten := opencv.problem()) is not None:
            yield Check(
                name=f"OpenCV {opencv.loaded_version() or ''}".strip(),
                state=BROKEN if opencv.loaded_version() is None else OTHER,
                detail=overwritten[0],
                mend=overwritten[1],
            )
            continue
        problem = _import_problem(m for m in modules[name] if not m.startswith("_"))
        if problem:
            yield Check(name=name_and_version, state=BROKEN, detail=problem, mend=mend)
            continue
        yield Check(name=name_and_version)
        if name == "av":
            yield _h264()


def _import_problem(modules: Iterable[str]) -> str:
    """Why one of these modules cannot be imported; empty when all can be."""
    for module in modules:
        try:
            import_module(module)
        except Exception as error:  # whatever a broken package raises is the finding
            return f"{module} does not import: {error}"
    return ""


def _extras() -> Iterator[Check]:
    """Check each optional package, and what it needs of the system."""
    for extra, about in EXTRAS.items():
        name, mend = f"extra {extra}, for {about.purpose}", install_command(extra)
        if find_spec(about.module) is None:
            yield Check(name=name, state=OPTIONAL, mend=mend)
            continue
        # pyrender does not import without the system's OpenGL, which is checked on its own.
        problem = "" if extra == "gl" else _import_problem([about.module])
        if problem:
            mend = mend.replace("install", "install --force-reinstall")
            yield Check(name=name, state=BROKEN, detail=problem, mend=mend)
            continue
        yield Check(name=name)
        if extra == "gl":
            yield _gl()


def _caches() -> Iterator[Check]:
    """Size and place of each cache that is there."""
    user, chosen = user_cache(), os.environ.get("NUMBA_CACHE_DIR")
    for name, words in _CACHES.items():
        yield from _size(words, str(user / name), [str(user / name)])
    kernels = [os.path.join(chosen, "chromagrip", "kernels")] if chosen else []
    package = str(Path(__file__).parents[1])
    inner = os.path.join("__pycache__", "kernels")
    own = [folder for folder, *_ in os.walk(package, followlinks=True) if folder.endswith(inner)]
    yield from _size(_CACHES["kernels"], "".join(kernels), kernels)
    yield from _size(_CACHES["kernels"], f"{package}, in folders {inner}", own)


def _size(words: str, where: str, folders: Iterable[str]) -> Iterator[Check]:
    """One line about a cache; none where its folders are missing or empty."""
    size = 0
    for folder, _, files in (entry for each in folders for entry in os.walk(each)):
        for name in files:
            with suppress(OSError):  # another process removed it
                size += os.path.getsize(os.path.join(folder, name))
    if size:
        yield Check(name=f"cache of {words}", detail=f"{size / 1e6:.0f} MB in {where}")


def _h264() -> Check:
    from av.codec import codecs_available

    name = "H.264 encoder"
    if "libx264" in codecs_available:
        return Check(name=name)
    mend = "pip install --force-reinstall --only-binary av av"
    return Check(name=name, state=BROKEN, detail="videos need PyAV with libx264", mend=mend)


def _gl() -> Check:
    name = "OpenGL for --renderer pyrender"
    try:
        from ..render.drawing import MEND, gl_problem

        problem, mend = gl_problem(), MEND
    except ImportError as error:
        problem, mend = f"cannot be asked: {error}", "mend the packages above first"
    if problem is None:
        return Check(name=name)
    return Check(name=name, state=OPTIONAL, detail=problem, mend=mend)
