import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import tomli_w
from matplotlib.figure import Figure
from msgspec.structs import asdict

from chromagrip.cli.calibrate import calibrate_sensor
from chromagrip.cli.pictures import estimate
from chromagrip.control import GripObservation
from chromagrip.errors import UserError
from chromagrip.loop.force_row import force_row
from chromagrip.loop.poses.poses import Pose, settle
from chromagrip.model import (
    ContactObject,
    ForceField,
    FrictionReading,
    contact_forces,
    equilibrium,
)
from chromagrip.output.parquet import FORCES, Row
from chromagrip.pictures.figure import draw_figure
from chromagrip.render import MembraneMap, add_noise, open_renderer
from chromagrip.scene.scene import load_scene
from chromagrip.sensing.margins import with_limit_margin
from chromagrip.tracking import CAMERA_RULE
from chromagrip.tracking.forces.calibration import FORMAT, Values, load_calibration, with_values

NOISE = 2.0
Change = Callable[[np.ndarray], np.ndarray]
NOMINAL = load_calibration("thesis")
#: Of the sensor in the pictures: stiffer than designed, its inner layer follows less.
VALUES = Values(
    tissue_stiffness_n_per_m=1.08 * NOMINAL.fingertip.tissue_stiffness,
    membrane_stiffness_n_per_m=1.08 * NOMINAL.fingertip.membrane_stiffness,
    tissue_poisson=NOMINAL.fingertip.poisson_tissue,
    yellow_follow=0.45,
    magenta_depth_mm=NOMINAL.sensor.magenta.depth_mm,
    yellow_depth_mm=NOMINAL.sensor.inner.depth_mm,
)
TRUE = with_values(NOMINAL, VALUES)
PAINTER = open_renderer("painter", TRUE.sensor)
MAP = MembraneMap(TRUE.sensor, TRUE.fingertip.nodes)
BERRY = ContactObject(stiffness=160.0, curvature=50.0, friction=0.6)


@dataclass(frozen=True)
class Folders:
    """Pictures of a grasp with their truth, and the calibration of the sensor in them."""

    rest: str
    grasp: Path
    calibration: str
    normal: np.ndarray
    friction: np.ndarray


def save(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1])


def read(path: Path) -> np.ndarray:
    return np.asarray(cv2.imread(str(path)))[..., ::-1].copy()


def shoot(path: Path, seen: np.ndarray, index: int) -> None:
    image = PAINTER.render(MAP(seen))
    add_noise(image, NOISE, 8, index)
    save(path, image)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Folders:
    root = tmp_path_factory.mktemp("estimate")
    grasp, tip = root / "grasp", TRUE.fingertip
    shoot(root / "rest.png", np.zeros((tip.nodes, 2)), 100)
    # Pressed, then pulled until Γ is 0.3.
    sums = []
    path = [(g, 0.0) for g in (0.5, 1.0, 1.5, 2.0)] + [(2.0, f) for f in (0.2, 0.5, 0.84)]
    for k, (grip, load) in enumerate(path):
        state = equilibrium(tip, BERRY, grip, load)
        shoot(grasp / f"{k}.png", state.deformation.seen, 200 + k)
        field = contact_forces(tip, BERRY, state)
        sums.append((field.total_normal, field.total_friction))
    calibration = root / "mine.toml"
    head = {"format": FORMAT, "sensor": "thesis", "stiffness_deviation": 0.02}
    calibration.write_text(tomli_w.dumps({**head, "values": asdict(VALUES)}), encoding="utf-8")
    return Folders(str(root / "rest.png"), grasp, str(calibration), *np.array(sums).T)


@pytest.fixture(scope="module")
def estimated(folders: Folders, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("out") / "mine"
    words = (folders.rest, str(folders.grasp))
    options = {"calibration": folders.calibration, "noise": NOISE, "fps": 100.0}
    assert estimate(*words, **options, out=out, json_only=True) == 0
    return out


def summary_of(out: Path) -> Any:
    return json.loads((out / "summary.json").read_text(encoding="utf-8"))


def column(out: Path, name: str) -> np.ndarray:
    values = pq.read_table(out / "estimates.parquet")[name].to_pylist()
    return np.array([np.nan if v is None else v for v in values], dtype=float)


def test_calibrated_forces_of_an_unseen_object_are_better(
    folders: Folders, estimated: Path, tmp_path: Path
) -> None:
    words = (folders.rest, str(folders.grasp))
    options = {"calibration": "thesis", "noise": NOISE, "fps": 100.0}
    assert estimate(*words, **options, out=tmp_path, json_only=True) == 0
    held = slice(3, None)
    mine, nominal = (
        np.sqrt(np.mean((column(out, "normal_n") / folders.normal - 1.0)[held] ** 2))
        for out in (estimated, tmp_path)
    )
    assert mine < 0.06
    assert mine < 0.7 * nominal
    low, high = (column(estimated, f"normal_{end}_n") for end in ("low", "high"))
    assert np.mean((low < folders.normal)[held] & (folders.normal < high)[held]) > 0.6
    friction = column(estimated, "friction_n") - folders.friction
    assert np.sqrt(np.mean(friction[held] ** 2)) < 0.05


def test_a_folder_holds_what_it_says(folders: Folders, estimated: Path) -> None:
    summary = summary_of(estimated)
    frames = len(folders.normal)
    assert (summary["format"], summary["frames"]) == ("chromagrip estimate 1", frames)
    assert summary["complete"]
    assert summary["without_estimate"] == 0
    assert summary["rest_misfit_px"] == summary["camera_pose"]["error_px"] < 0.05
    assert summary["camera_pose"]["roll_deg"] == pytest.approx(0.0, abs=0.01)
    assert not summary["camera_pose"]["notable"]
    table = pq.read_table(estimated / "estimates.parquet")
    assert table.column_names == list(FORCES)
    np.testing.assert_allclose(column(estimated, "time_s"), np.arange(frames) / 100.0)
    for name in ("normal_n", "friction_n", "mu", "margin"):
        values = column(estimated, name)
        assert summary["estimates"][name]["last"] == values[-1]
        low, high = (column(estimated, end) for end in _ends(name))
        known = np.isfinite(low)
        assert known[-1]
        assert summary["estimates"][name]["last_interval"] == [low[-1], high[-1]]
        assert (low <= values)[known].all()
        assert (values <= high)[known].all()
    nodes = np.array(table["node_normal_n"].to_pylist())
    np.testing.assert_allclose(nodes.sum(axis=1), column(estimated, "normal_n"), rtol=0.05)
    assert cv2.imread(str(estimated / "figure.png")) is not None
    with av.open(str(estimated / "overlay.mp4")) as video:
        assert len(list(video.decode(video=0))) == frames


def test_force_and_torque_have_intervals_of_their_own() -> None:
    """Two nodes of a dome, one pulled along y at 2 mm from its axis."""
    field = ForceField(
        position=np.array([[2e-3, 0.0, 0.02], [-2e-3, 0.0, 0.02]]),
        normal=np.array([1.0, 1.0]),
        friction=np.array([[0.0, 0.3, 0.0], [0.0, 0.0, 0.0]]),
        contact=np.ones(2, bool),
        totals_covariance=np.zeros((2, 2)),
        directions=np.array([[0.0, 0.0, -1.0]] * 2),
        friction_reading=FrictionReading(value=0.5, deviation=0.0, observable=True),
        wrench_covariance=np.diag([0.1, 0.2, 0.3, 1e-4]) ** 2,
    )
    margin = field.safety_margin(0.5)
    observation = GripObservation(
        time=0.0, field=field, friction=0.5, friction_interval=(0.5, 0.5),
        friction_observable=True, margin=margin, margin_interval=(margin, margin),
        lateral_displacement=np.nan,
    )  # fmt: skip
    row = force_row(with_limit_margin(observation), CAMERA_RULE)
    for name, unit, value, deviation in (
        ("force_y", "n", 0.3, 0.2),
        ("force_z", "n", -2.0, 0.3),
        ("torque", "nmm", 0.6, 0.1),
    ):
        assert row[f"{name}_{unit}"] == pytest.approx(value)
        assert row[f"{name}_low_{unit}"] == pytest.approx(value - 1.645 * deviation, rel=1e-3)
        assert row[f"{name}_high_{unit}"] == pytest.approx(value + 1.645 * deviation, rel=1e-3)
    assert row["limit_margin_low"] < row["limit_margin"] < row["margin"]


def _ends(name: str) -> tuple[str, str]:
    stem, unit = (name[:-2], "_n") if name.endswith("_n") else (name, "")
    return f"{stem}_low{unit}", f"{stem}_high{unit}"


def test_a_frame_that_says_nothing_says_so(
    folders: Folders, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    for k in range(3):
        shutil.copy(folders.grasp / "3.png", frames / f"{k}.png")
    hidden = read(frames / "1.png")
    hidden[80:400, 160:480] = 128
    save(frames / "1.png", hidden)
    out = tmp_path / "out"
    words = (folders.rest, str(frames))
    assert estimate(*words, calibration=folders.calibration, noise=NOISE, out=out) == 0
    told = capsys.readouterr().out
    assert "1 of 3, 33.3% of the frames" in told
    assert "1: the markers move as no trained press moves" in told
    assert "µ observable in 0 frames: the markers show no slip" in " ".join(
        told.split()
    )  # a pure press
    row = pq.read_table(out / "estimates.parquet").to_pylist()[1]
    assert "as no trained press moves them" in row["no_estimate"]
    said = {"frame", "time_s", "markers_seen", "no_estimate"}
    assert {name for name, value in row.items() if value is not None} == said
    assert np.isfinite(column(out, "normal_n")).tolist() == [True, False, True]


REFUSED: list[tuple[str, dict[str, Any], Change | None, str]] = [
    ("dome-2022", {}, None, r"calibration dome-2022: \d+ % of the markers at rest lie"),
    ("thesis", {}, lambda image: image[:, 80:560], "480×480 .* crop=480:360:LEFT:TOP"),
    ("thesis", {}, np.fliplr, r"turned and shifted, \d+\.\d px RMS from them"),
    ("flat-2019", {}, None, "a flat pad, which has no force model"),
    ("thesis", {"reconstructor": "wish"}, None, "no reconstructor 'wish'"),
    ("thesis", {"tracker": "lk"}, None, "tracker 'lk' does not estimate the covariances"),
    ("thesis", {"window": 0.0}, None, "--window 0.0"),
]


@pytest.mark.parametrize(("calibration", "options", "change", "words"), REFUSED)
def test_what_does_not_fit_is_refused_with_the_reason(
    folders: Folders,
    tmp_path: Path,
    no_forces: str,
    calibration: str,
    options: dict[str, Any],
    change: Change | None,
    words: str,
) -> None:
    rest, out = tmp_path / "rest.png", tmp_path / "out"
    image = read(Path(folders.rest))
    save(rest, image if change is None else change(image))
    options = {"calibration": calibration, "noise": NOISE, "out": out, **options}
    if calibration == "dome-2022":  # as there is no read-out of the sensor
        options["reconstructor"] = no_forces
    with pytest.raises(UserError, match=words):
        estimate(str(rest), str(folders.grasp), json_only=True, **options)
    assert not out.exists()


def test_a_flat_pad_is_calibrated_and_read_by_its_displacements(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = load_scene("camera-100hz", {"sensor": "flat-2019"})
    sensor = scene.build_sensor()
    painter, skin = open_renderer("painter", sensor), MembraneMap(sensor, scene.fingertip.nodes)

    def press(path: Path, depth: float, shear: float, index: int) -> None:
        pose = Pose(depth=1e-3 * depth, shear=1e-3 * shear)
        image = painter.render(skin(settle(scene, pose)[0].deformation.seen))
        add_noise(image, NOISE, 9, index)
        save(path, image)

    presses, frames = tmp_path / "presses", tmp_path / "frames"
    still = painter.render(skin(np.zeros((scene.fingertip.nodes, 2))))
    save(presses / "rest.png", still)
    lines = ["file,depth_mm,shear_mm"]
    for k, (depth, shear) in enumerate([(0.1, 0.0), (0.2, 0.2), (0.3, 0.0), (0.4, 0.2)]):
        press(presses / f"{k}.png", depth, shear, k)
        lines.append(f"{k}.png,{depth},{shear}")
    (presses / "presses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    for k in range(4):
        press(frames / f"{k}.png", 0.1 * (k + 1) - 0.05, 0.05 * k, 10 + k)
    out, calibration = tmp_path / "out", tmp_path / "pad.toml"
    options: dict[str, Any] = {"tracker": "detect", "noise": NOISE}
    assert calibrate_sensor(presses, sensor="flat-2019", out=calibration, **options) == 0
    rest = str(presses / "rest.png")
    assert estimate(rest, str(frames), calibration=str(calibration), out=out, **options) == 0
    told = capsys.readouterr().out
    assert "displacement into the pad" in told
    assert "safety margin" not in told
    np.testing.assert_allclose(column(out, "depth_mm"), [0.05, 0.15, 0.25, 0.35], atol=0.02)
    np.testing.assert_allclose(column(out, "shift_x_mm"), [0.0, 0.05, 0.1, 0.15], atol=0.02)
    np.testing.assert_allclose(column(out, "shift_y_mm"), 0.0, atol=0.02)
    assert (out / "figure.png").is_file()
    assert (out / "overlay.mp4").is_file()


def test_the_figure_has_true_curves_and_gaps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The middle frame has no estimate; its mark is at the edge and not at a value of 0."""
    drawn: list[Figure] = []
    save = Figure.savefig

    def kept(figure: Figure, *words: Any, **more: Any) -> None:
        drawn.append(figure)
        save(figure, *words, **more)

    monkeypatch.setattr(Figure, "savefig", kept)
    rows: list[Row] = [
        {"frame": k + 1, "time_s": 0.1 * k, "no_estimate": "", "normal_n": 2.0, "mu": 0.4}
        for k in range(3)
    ]
    rows[1] = {"frame": 2, "time_s": 0.1, "no_estimate": "dark"}
    truth = {"normal_n": np.array([9.0, 1.0, 1.1, 1.2]), "mu": np.full(4, 0.5)}
    draw_figure(rows, False, tmp_path / "figure.png", truth)
    draw_figure(rows, False, tmp_path / "figure.png", {})
    force, _, margin = drawn[0].axes
    lines = {str(line.get_label()): line for line in force.lines}
    assert list(lines) == ["ΣFn, 90 %", "ΣFn, true", "ΣFf, 90 %", "no estimate"]
    assert lines["ΣFn, true"].get_ydata() == pytest.approx([1.0, 1.1, 1.2])
    assert lines["ΣFn, true"].get_linestyle() == "--"
    assert np.isnan(lines["ΣFn, 90 %"].get_ydata()).tolist() == [False, True, False]
    mark = lines["no estimate"].get_transform().transform([(0.1, 0.03)])[0]
    assert mark[1] < force.transData.transform([(0.1, 0.0)])[0][1] or force.get_ylim()[0] > 0.0
    assert "true" not in {str(line.get_label()) for line in margin.lines}
    assert not any("true" in str(line.get_label()) for axes in drawn[1].axes for line in axes.lines)
