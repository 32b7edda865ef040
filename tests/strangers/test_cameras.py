"""Camera files of strangers: each is read, or refused in one sentence that names the file."""

from pathlib import Path
from random import Random

import pytest

from chromagrip.render import load_camera

from ..render.test_camera_files import FIVE, HEIGHT, WIDTH, WRITERS, kalibr, ros
from .damages import harmed
from .judged import Judge, few_and_many, repeated


@few_and_many(40, 2500)
def test_damaged_camera_files_are_read_or_refused(judged: Judge, count: int) -> None:
    def check(draw: Random) -> None:
        with judged.files() as folder:
            path = WRITERS[draw.choice(list(WRITERS))](folder, FIVE)
            harmed(path, draw)
            size = draw.choice((None, (WIDTH, HEIGHT)))
            model = draw.choice((None, "pinhole", "fisheye"))
            judged.call(lambda: load_camera(path, size, model), names=path.name)

    repeated(check, count)
    assert judged.refused > count // 3


BENT = [-0.12, 0.03, 0.0007, -0.0011, 0.004, 0.0, 0.0, 0.05]
MATRIX = "[9, 0, 4, 0, 9, 3, 0, 0, 1]"
#: Texts of files by their names, and what is said of each.
ATTACKS = {
    "text.yml": ("hello", "it is no YAML, XML or JSON that OpenCV reads"),
    "deep.yml": ("a: " + "[" * 100_000, "it is nested too deeply"),  # OpenCV crashes at these
    "deep.xml": ("<opencv_storage>" + "<a>" * 100_000, "it is nested too deeply"),
    "python.yaml": ("a: !!python/object/apply:os.system ['touch outside/x']", "python.yaml"),
    "bomb.xml": (
        '<!DOCTYPE a [<!ENTITY b "bbbbbbbb"><!ENTITY c "&b;&b;&b;">]><opencv_storage>&c;'
        "</opencv_storage>",
        "bomb.xml",
    ),
    "left.yml": ("    - 1\n-\nb:\n", "a line of it stands further left than the first"),
    "row.yml": ("- 1\n:\n  stamp:\n", "a line of it stands further left than the first"),
    "zip.npz": ("hello", "it cannot be read: File is not a zip file"),
    "list.json": (
        f'{{"K": {MATRIX}, "D": [1], "distortion_model": [1], "image_size": [9, 9]}}',
        "distortion_model [1.0] is none of ours",
    ),
    "key.yml": ("d: [1]", "it has no matrix: none of the keys camera_mat"),
    "words.json": ('{"K": [["x"]], "D": [1]}', "is no list of numbers"),
    "few.json": ('{"K": [1, 2], "D": [1]}', "has 2 numbers; allowed: 9"),
    "skew.json": (f'{{"K": {MATRIX.replace("9, 0,", "9, 0.5,")}, "D": [1]}}', "focal lengths"),
    "two.yml": ("cam0:\n  k: [1]\ncam1:\n  k: [1]\n", "has the cameras cam0, cam1; keep one"),
    "size.json": (f'{{"K": {MATRIX}, "D": [0, 0, 0, 0, 0]}}', "names no size of the images"),
}


@pytest.mark.parametrize("name", ATTACKS)
def test_each_kind_of_wrong_file_is_a_sentence(judged: Judge, name: str) -> None:
    text, told = ATTACKS[name]
    with judged.files() as folder:
        (folder / name).write_text(text)
        judged.call(lambda: load_camera(Path("given") / name), names=told)
        assert judged.refused == 1


@pytest.mark.parametrize(
    ("write", "told"),
    [
        (lambda f: ros(f, BENT), "px off its 8 coefficients; allowed: 0.1 px"),
        (lambda f: ros(f, [-0.12, 0.03, 0, 0, 0.01, 0.3, -0.2, 0.1]), "fold the pinhole's"),
        (lambda f: kalibr(f, FIVE[:4], camera="omni"), "camera_model 'omni' is none of ours"),
        (lambda f: kalibr(f, FIVE[:4], "fov"), "distortion_model 'fov' is none of ours; allowed"),
    ],
)
def test_lenses_that_are_none_of_ours_are_told(judged: Judge, write: object, told: str) -> None:
    with judged.files() as folder:
        path = write(folder)  # type: ignore[operator]
        judged.call(lambda: load_camera(path), names=told)
    assert judged.refused == 1
