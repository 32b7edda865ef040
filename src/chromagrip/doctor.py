"""What this machine lacks, and the command that mends it."""

import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

import chromagrip

from .render.gl import MEND, gl_problem

FOLDERS = ("model", "render", "tracking", "control")


@dataclass(frozen=True, kw_only=True)
class Check:
    """One part: its name, whether it is there, and if not why and what mends it."""

    name: str
    fine: bool
    required: bool = True
    detail: str = ""
    mend: str = ""


def diagnose() -> list[Check]:
    """Checks of this machine, in the order in which to mend."""
    return [_python(), *_folders(), *_packages(), _video(), _gl()]


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
    root = Path(chromagrip.__path__[0])
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
    checks = []
    for line in requires("chromagrip") or []:
        if "extra ==" in line:
            continue
        name = line.split(";")[0].split("[")[0]
        for sign in "<>=!~ ":
            name = name.split(sign)[0]
        try:
            found, fine = version(name), True
        except PackageNotFoundError:
            found, fine = "", False
        checks.append(
            Check(
                name=f"{name} {found}".strip(),
                fine=fine,
                detail="not installed",
                mend=f"pip install '{line.split(';')[0].strip()}'",
            )
        )
    return checks


def _video() -> Check:
    import av

    return Check(
        name="H.264 encoder",
        fine="libx264" in av.codecs_available,
        detail="this build of PyAV has no libx264, which tactile.mp4 needs",
        mend="pip install --force-reinstall --only-binary av av",
    )


def _gl() -> Check:
    problem = gl_problem()
    return Check(
        name="OpenGL for --renderer pyrender",
        fine=problem is None,
        required=False,
        detail=problem or "",
        mend=MEND,
    )
