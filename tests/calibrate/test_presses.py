"""Lists and pictures of presses that cannot be used, each refused in one sentence."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from chromagrip.calibrate.sensor import calibrate_sensor
from chromagrip.errors import UserError
from chromagrip.render import MembraneMap, load_sensor, open_renderer

FORCES = "file,normal_n,lateral_n"
ON_SILICONE = f"{FORCES},torque_nmm,radius_mm"


def refused(folder: Path, sensor: str, lines: list[str], tracker: str = "fit") -> str:
    """Words with which a list is refused."""
    (folder / "presses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(UserError) as refusal:
        calibrate_sensor(folder, load_sensor(sensor), tracker=tracker)
    assert "\n" not in str(refusal.value)
    return str(refusal.value)


def test_lists_are_refused_with_the_reason(tmp_path: Path) -> None:
    for lines, words in (
        ([FORCES], "has no presses"),
        (["file,force", "a.png,1"], "has the columns file, force; wanted"),
        ([FORCES, "a.png,nan,0"], "normal_n is 'nan', which is no number"),
        ([FORCES, "a.png,-1,0"], "normal_n is -1; wanted: above 0"),
        ([FORCES, "a.png,1"], "presses.csv has not 3 values"),
        ([ON_SILICONE, "a.png,1,0,0,-8"], "radius_mm is -8; wanted: 0 or above"),
        ([FORCES, "a.png,2,0", "b.png,2.5,0"], "do not determine a stiffness"),
        ([FORCES, "a.png,1,0", "b.png,4,5"], "N, at which a plate slips"),
        (["file,depth_mm", "a.png,1"], "gives displacements, but the sensor is a dome"),
        ([FORCES, "a.png,1,0", "b.png,2,0"], "has no rest*.png"),
    ):
        assert words in refused(tmp_path, "dome-2020", lines)
    words = refused(tmp_path, "thesis", [FORCES, "a.png,1,0", "b.png,2,0"])
    assert "read as a chain is not calibrated" in words
    assert "the sensor is a flat pad" in refused(tmp_path, "flat-2019", [FORCES, "a.png,1,0"])


def test_a_press_that_is_missing_or_without_its_markers_is_refused(tmp_path: Path) -> None:
    sensor, nodes = load_sensor("flat-2019"), 251
    still = MembraneMap(sensor, nodes)(np.zeros((nodes, 2)))
    image = open_renderer("painter", sensor).render(still)
    assert cv2.imwrite(str(tmp_path / "rest.png"), image[..., ::-1])
    image[:, 100:540] = 128
    assert cv2.imwrite(str(tmp_path / "grey.png"), image[..., ::-1])
    header = "file,depth_mm,shear_mm"
    words = refused(tmp_path, "flat-2019", [header, "grey.png,0.1,0"], "detect")
    assert "of the 100 marker pairs at rest; wanted: at least 50%" in words
    assert "b.png cannot be read" in refused(
        tmp_path, "flat-2019", [header, "b.png,0.1,0"], "detect"
    )
