"""What this machine lacks, and the command that mends it.

Nothing but the standard library is imported before it is checked: a missing part must not keep the
doctor from naming it.
"""

import sys
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import packages_distributions, requires, version
from pathlib import Path

FOLDERS = ("model", "render", "tracking", "control")
#: Imports OpenGL, which is checked on its own and may be absent.
OPENGL_PACKAGE = "pyrender-maintained"


@dataclass(frozen=True, kw_only=True)
class Check:
    """One part: its name, whether it is there, and if not why and what mends it."""

    name: str
    fine: bool
    required: bool = True
    detail: str = ""
    mend: str = ""


def report() -> int:
    """Print every check; exit code 1 if a required part is missing, else 0."""
    problems = 0
    for check in [_python(), *_folders(), *_packages(), _video(), _gl()]:
        mark = "ok" if check.fine else ("missing" if check.required else "optional, missing")
        print(f"{check.name}: {mark}{'' if check.fine else f' ({check.detail})'}")
        if not check.fine:
            print(f"    mend: {check.mend}")
            problems += check.required
    return 1 if problems else 0


def _python() -> Check:
    found = ".".join(map(str, sys.version_info[:3]))
    return Check(
        name=f"Python {found}",
        fine=sys.version_info >= (3, 11),
        detail="3.11 or newer is needed",
        mend="install Python 3.11 or newer and set PYTHON to its path",
    )


def _folders() -> list[Check]:
    """The links of a checkout; a checkout without symlinks has text files in their place."""
    root = Path(__file__).parents[1]
    return [
        Check(
            name=f"package folder {name}",
            fine=(root / name / "__init__.py").is_file(),
            detail=f"{root / name} is not a folder: checked out without symbolic links",
            mend="git config core.symlinks true && git checkout -- src/chromagrip",
        )
        for name in FOLDERS
    ]


def _packages() -> list[Check]:
    modules: dict[str, list[str]] = {}
    for module, distributions in packages_distributions().items():
        for name in distributions:
            modules.setdefault(name.lower().replace("_", "-"), []).append(module)
    listed = [line for line in requires("chromagrip") or [] if "extra ==" not in line]
    wanted = [line.split(";")[0].strip() for line in listed]
    return [_package(requirement, modules) for requirement in wanted]


def _package(requirement: str, modules: dict[str, list[str]]) -> Check:
    name = requirement
    for sign in "<>=!~[ ":
        name = name.split(sign)[0]
    problem = "" if name in modules else "not installed"
    for module in modules.get(name, []):
        if name == OPENGL_PACKAGE or module.startswith("_"):
            continue
        try:
            import_module(module)
        except Exception as error:  # whatever a broken package raises is the finding
            problem = f"does not import: {error}"
    return Check(
        name=f"{name} {version(name)}" if name in modules else name,
        fine=not problem,
        detail=problem,
        mend=f"pip install --force-reinstall '{requirement}'",
    )


def _video() -> Check:
    try:
        from av.codec import codecs_available
    except ImportError:
        codecs_available = set()
    return Check(
        name="H.264 encoder",
        fine="libx264" in codecs_available,
        detail="tactile.mp4 needs PyAV with libx264",
        mend="pip install --force-reinstall --only-binary av av",
    )


def _gl() -> Check:
    try:
        from ..render.drawing.gl import MEND, gl_problem

        problem, mend = gl_problem(), MEND
    except ImportError as error:
        problem, mend = f"cannot be asked: {error}", "mend the packages above first"
    return Check(
        name="OpenGL for --renderer pyrender",
        fine=problem is None,
        required=False,
        detail=problem or "",
        mend=mend,
    )
