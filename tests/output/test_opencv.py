"""What is said of an OpenCV that other distributions have overwritten."""

import json
import subprocess
import sys
from pathlib import Path

import chromagrip

SOURCE = Path(chromagrip.__file__).parents[1]
#: Prints what is found among the packages of one folder, and the notice of it, twice.
ASK = """
import json, os, sys
standard = [each for each in sys.path if "site-packages" not in each]
sys.path[:] = [*standard, *sys.argv[1:]]
os.environ["XDG_CACHE_HOME"] = sys.argv[1]
from chromagrip.output import opencv
found = opencv.problem()
said = [opencv.notice(found) for _ in range(2)] if found else []
print(json.dumps([opencv.loaded_version(), found, said]))
"""


def found(folder: Path, installed: dict[str, str], loaded: str | None) -> list[object]:
    """Loaded version, problem, and notices where these distributions are installed."""
    for name, version in installed.items():
        place = folder / f"{name.replace('-', '_')}-{version}.dist-info"
        place.mkdir()
        (place / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
        )
    if installed:
        (folder / "cv2").mkdir()
        (folder / "cv2/data.txt").touch()
    if loaded is not None:
        (folder / "cv2/__init__.py").touch()
        (folder / "cv2/version.py").write_text(f'opencv_version = "{loaded}"\n')
    asked = [sys.executable, "-I", "-S", "-c", ASK, str(folder), str(SOURCE)]
    answer = subprocess.run(asked, capture_output=True, text=True, check=True).stdout
    return list(json.loads(answer))


def test_one_distribution_is_no_problem(tmp_path: Path) -> None:
    installed = {"opencv-contrib-python-headless": "4.13.0.92"}
    assert found(tmp_path, installed, "4.13.0.92") == ["4.13.0.92", None, []]


def test_another_distribution_alone_is_no_problem(tmp_path: Path) -> None:
    assert found(tmp_path, {"opencv-python": "4.12.0.88"}, "4.12.0.88") == ["4.12.0.88", None, []]


def test_none_is_no_problem_of_ours(tmp_path: Path) -> None:
    assert found(tmp_path, {}, None) == [None, None, []]


def test_two_distributions_are_said_once_with_the_loaded_version(tmp_path: Path) -> None:
    installed = {"opencv-contrib-python-headless": "4.14.0.94", "opencv-python": "4.12.0.88"}
    loaded, problem, said = found(tmp_path, installed, "4.12.0.88")
    assert loaded == "4.12.0.88"
    assert problem == [
        "the folder cv2 belongs to opencv-contrib-python-headless 4.14.0.94, opencv-python "
        "4.12.0.88: loaded is OpenCV 4.12.0.88",
        "pip uninstall -y opencv-python && "
        "pip install --force-reinstall --no-deps opencv-contrib-python-headless",
    ]
    assert said == [f"{problem[0]}; to have the tested one: {problem[1]}", None]


def test_a_damaged_folder_names_the_distribution_that_mends_it(tmp_path: Path) -> None:
    _, problem, _ = found(tmp_path, {"opencv-python": "4.12.0.88"}, None)
    assert problem == [
        "the folder cv2 is damaged: another OpenCV was installed or removed there",
        "pip install --force-reinstall --no-deps opencv-python",
    ]
