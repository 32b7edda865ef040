"""What is said of an OpenCV that other distributions have overwritten."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import chromagrip

#: Prints what is found among the packages of folders, and the notices of it, asked for twice.
ASK = """
import json, os, sys
standard = [each for each in sys.path if "site-packages" not in each]
from importlib import invalidate_caches
answers = []
for folder in sys.argv[2:]:
    sys.path[:] = [*standard, folder, sys.argv[1]]
    os.environ["XDG_CACHE_HOME"] = folder
    invalidate_caches()
    from chromagrip.output import opencv
    found = opencv.problem()
    said = [opencv.notice(found) for _ in range(2)] if found else []
    answers.append([opencv.loaded_version(), found, said])
print(json.dumps(answers))
"""
OURS, OTHER = "opencv-contrib-python-headless", "opencv-python"
TWO = (
    "the folder cv2 belongs to opencv-contrib-python-headless 4.14.0.94, opencv-python 4.12.0.88: "
    "loaded is OpenCV 4.12.0.88"
)
TWO_MENDED = f"pip uninstall -y {OTHER} && pip install --force-reinstall --no-deps {OURS}"
DAMAGED = "the folder cv2 is damaged: another OpenCV was installed or removed there"
MENDED = f"pip install --force-reinstall --no-deps {OTHER}"
#: Installed distributions and the version that is loaded; problem and its mend.
CASES: list[tuple[dict[str, str], str | None, list[str] | None]] = [
    ({OURS: "4.13.0.92"}, "4.13.0.92", None),
    ({OTHER: "4.12.0.88"}, "4.12.0.88", None),
    ({}, None, None),
    ({OURS: "4.14.0.94", OTHER: "4.12.0.88"}, "4.12.0.88", [TWO, TWO_MENDED]),
    ({OTHER: "4.12.0.88"}, None, [DAMAGED, MENDED]),
]


@pytest.mark.filterwarnings("default")
def test_an_overwritten_opencv_is_said_once_with_its_mend(tmp_path: Path) -> None:
    for number, (installed, loaded, _) in enumerate(CASES):
        folder = tmp_path / str(number)
        folder.mkdir()
        for name, version in installed.items():
            place = folder / f"{name.replace('-', '_')}-{version}.dist-info"
            place.mkdir()
            text = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
            (place / "METADATA").write_text(text)
            (folder / "cv2").mkdir(exist_ok=True)
            (folder / "cv2/data.txt").touch()
        if loaded is not None:
            (folder / "cv2/__init__.py").touch()
            (folder / "cv2/version.py").write_text(f'opencv_version = "{loaded}"\n')
    source = str(Path(chromagrip.__file__).parents[1])
    folders = [str(tmp_path / str(number)) for number in range(len(CASES))]
    asked = [sys.executable, "-I", "-S", "-c", ASK, source, *folders]
    answers = json.loads(subprocess.run(asked, capture_output=True, text=True, check=True).stdout)
    for (_, loaded, problem), answer in zip(CASES, answers, strict=True):
        said = [f"{problem[0]}; to have the tested one: {problem[1]}", None] if problem else []
        assert answer == [loaded, problem, said]
