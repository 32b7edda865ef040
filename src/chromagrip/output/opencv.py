"""OpenCV that is loaded: several distributions install the same folder `cv2` over each other."""

import re
from collections.abc import Iterator
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path

from ..folders import user_cache

#: Distribution that chromagrip depends on; the others install into its folder.
OURS = "opencv-contrib-python-headless"
OTHERS = ("opencv-python", "opencv-python-headless", "opencv-contrib-python")


def loaded_version() -> str | None:
    """Version of the OpenCV that `import cv2` loads; None if there is none, or a damaged one."""
    spec = find_spec("cv2")
    for folder in (spec.submodule_search_locations or ()) if spec is not None else ():
        file = Path(folder) / "version.py"
        if file.is_file() and (Path(folder) / "__init__.py").is_file():
            found = re.search(r'opencv_version = "([^"]+)"', file.read_text(encoding="utf-8"))
            return found[1] if found else None
    return None


def _installed() -> Iterator[tuple[str, str]]:
    """Name and version of each installed distribution of OpenCV."""
    for name in (OURS, *OTHERS):
        try:
            yield name, version(name)
        except PackageNotFoundError:
            continue


def problem() -> tuple[str, str] | None:
    """Describe an OpenCV that was overwritten or damaged in a sentence, and its mend.

    Returns
    -------
    sentence and command that mends it; None if one distribution is installed and whole
    """
    installed, loaded = dict(_installed()), loaded_version()
    if not installed or find_spec("cv2") is None:
        return None  # another package manager's cv2, or none, which its import reports
    kept = OURS if OURS in installed else next(iter(installed))
    again = f"pip install --force-reinstall --no-deps {kept}"
    if loaded is None:
        return "the folder cv2 is damaged: another OpenCV was installed or removed there", again
    if len(installed) == 1:
        return None
    names = ", ".join(f"{name} {number}" for name, number in installed.items())
    others = " ".join(name for name in installed if name != kept)
    sentence = f"the folder cv2 belongs to {names}: loaded is OpenCV {loaded}"
    return sentence, f"pip uninstall -y {others} && {again}"


def notice(found: tuple[str, str]) -> str | None:
    """Sentence about an overwritten OpenCV, once for each `problem` that is found; else None."""
    digest = sha256(found[0].encode()).hexdigest()[:16]
    mark = user_cache() / f"opencv-{digest}"
    try:
        mark.parent.mkdir(parents=True, exist_ok=True)
        with mark.open("x"):
            pass
    except FileExistsError:
        return None
    except OSError:
        pass  # without a cache it is said each time
    return f"{found[0]}; to have the tested one: {found[1]}"
