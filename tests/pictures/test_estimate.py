import io
import json
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

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
from chromagrip.pictures.readings import _displacement_row, force_reading
from chromagrip.render import MembraneMap, add_noise, open_renderer
from chromagrip.scene.scene import load_scene
from chromagrip.sensing.margins import with_limit_margin
from chromagrip.tracking import CAMERA_RULE, DisplacementGains, Tracks
from chromagrip.tracking.forces.calibration import FORMAT, Values, load_calibration, with_values

from .drawn_dots import save

NOISE = 2.0
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
class Run:
    """Pictures of a grasp with their truth and calibration, the estimates, and what was printed."""

    rest: str
    grasp: Path
    calibration: str
    normal: np.ndarray
    friction: np.ndarray
    out: Path
    told: str

    def column(self, name: str) -> np.ndarray:
        return column(self.out, name)


def read(path: Path) -> np.ndarray:
    return np.asarray(cv2.imread(str(path)))[..., ::-1].copy()


def shoot(path: Path, seen: np.ndarray, index: int) -> None:
    image = PAINTER.render(MAP(seen))
    add_noise(image, NOISE, 8, index)
    save(path, image)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A press that is pulled until Γ is 0.3; the second picture is covered in the middle."""
    root = tmp_path_factory.mktemp("estimate")
    grasp, tip, rest = root / "grasp", TRUE.fingertip, str(root / "rest.png")
    shoot(Path(rest), np.zeros((tip.nodes, 2)), 100)
    sums = []
    for k, load in enumerate((0.0, 0.0, 0.84)):
        state = equilibrium(tip, BERRY, 2.0, load)
        shoot(grasp / f"{k}.png", state.deformation.seen, 200 + k)
        field = contact_forces(tip, BERRY, state)
        sums.append((field.total_normal, field.total_friction))
    covered = read(grasp / "1.png")
    covered[80:400, 160:480] = 128
    save(grasp / "1.png", covered)
    calibration, out, told = str(root / "mine.toml"), root / "mine", io.StringIO()
    head = {"format": FORMAT, "sensor": "thesis", "stiffness_deviation": 0.02}
    text = tomli_w.dumps({**head, "values": asdict(VALUES)})
    Path(calibration).write_text(text, encoding="utf-8")
    with redirect_stdout(told):
        options: dict[str, Any] = {"noise": NOISE, "fps": 100.0, "out": out}
        assert estimate(rest, str(grasp), calibration=calibration, **options) == 0
    said = " ".join(told.getvalue().split())
    return Run(rest, grasp, calibration, *np.array(sums).T, out, said)


def column(out: Path, name: str) -> np.ndarray:
    values = pq.read_table(out / "estimates.parquet")[name].to_pylist()
    return np.array([np.nan if v is None else v for v in values], dtype=float)


def test_forces_of_an_unseen_object_are_those_of_the_model(run: Run) -> None:
    held = [0, 2]
    normal, low, high = (run.column(f"normal{end}_n")[held] for end in ("", "_low", "_high"))
    np.testing.assert_allclose(normal, run.normal[held], rtol=0.06)
    assert ((low < run.normal[held]) & (run.normal[held] < high)).any()
    np.testing.assert_allclose(run.column("friction_n")[held], run.friction[held], atol=0.05)


def test_a_folder_holds_what_it_says(run: Run) -> None:
    summary = json.loads((run.out / "summary.json").read_text(encoding="utf-8"))
    frames = len(run.normal)
    assert (summary["format"], summary["frames"]) == ("chromagrip estimate 1", frames)
    assert summary["complete"]
    assert summary["without_estimate"] == 1
    assert summary["rest_misfit_px"] == summary["camera_pose"]["error_px"] < 0.05
    assert summary["camera_pose"]["roll_deg"] == pytest.approx(0.0, abs=0.01)
    assert not summary["camera_pose"]["notable"]
    table = pq.read_table(run.out / "estimates.parquet")
    assert table.column_names == list(FORCES)
    np.testing.assert_allclose(run.column("time_s"), np.arange(frames) / 100.0)
    for name in ("normal_n", "friction_n", "mu", "margin"):
        values = run.column(name)
        assert summary["estimates"][name]["last"] == values[-1]
        stem, unit = (name[:-2], "_n") if name.endswith("_n") else (name, "")
        low, high = (run.column(f"{stem}_{end}{unit}") for end in ("low", "high"))
        known = np.isfinite(low)
        assert known[-1]
        assert summary["estimates"][name]["last_interval"] == [low[-1], high[-1]]
        assert (low <= values)[known].all()
        assert (values <= high)[known].all()
    for nodes, total in zip(
        table["node_normal_n"].to_pylist(), run.column("normal_n"), strict=True
    ):
        assert nodes is None or sum(nodes) == pytest.approx(total, rel=0.05)
    assert cv2.imread(str(run.out / "figure.png")) is not None
    with av.open(str(run.out / "overlay.mp4")) as video:
        assert len(list(video.decode(video=0))) == frames


def test_a_frame_that_says_nothing_says_so(run: Run) -> None:
    assert "1 of 3, 33.3% of the frames" in run.told
    assert "1: the markers move as no trained press moves" in run.told
    rows = pq.read_table(run.out / "estimates.parquet").to_pylist()
    assert "as no trained press moves them" in rows[1]["no_estimate"]
    said = {"frame", "time_s", "markers_seen", "no_estimate"}
    assert {name for name, value in rows[1].items() if value is not None} == said
    assert np.isfinite(run.column("normal_n")).tolist() == [True, False, True]
    # A pure press shows no slip.
    assert [bool(row["mu_observable"]) for row in rows] == [False, False, True]


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


OTHER_POSE = pytest.mark.data  # a search for the pose of another sensor's picture takes its time


@pytest.mark.parametrize(
    ("calibration", "options", "change", "words"),
    [
        pytest.param("dome-2022", {}, None, r"dome-2022: \d+ % of the markers", marks=OTHER_POSE),
        ("thesis", {}, lambda image: image[:, 80:560], "480×480 .* crop=480:360:LEFT:TOP"),
        pytest.param("thesis", {}, np.fliplr, r"turned and shifted, \d", marks=OTHER_POSE),
        ("flat-2019", {}, None, "a flat pad, which has no force model"),
        ("thesis", {"window": 0.0}, None, "--window 0.0"),
    ],
)
def test_what_does_not_fit_is_refused_with_the_reason(
    calibration: str,
    options: dict[str, Any],
    change: Callable[[np.ndarray], np.ndarray] | None,
    words: str,
    run: Run,
    tmp_path: Path,
    no_forces: str,
) -> None:
    rest, out, image = tmp_path / "rest.png", tmp_path / "out", read(Path(run.rest))
    save(rest, image if change is None else change(image))
    options = {"calibration": calibration, "noise": NOISE, "out": out, **options}
    if calibration == "dome-2022":  # as there is no read-out of the sensor
        options["reconstructor"] = no_forces
    with pytest.raises(UserError, match=words):
        estimate(str(rest), str(run.grasp), json_only=True, **options)
    assert not out.exists()


def test_forces_are_read_from_a_tracker_with_covariances_alone() -> None:
    rest = Tracks.of_positions(0.0, np.zeros((2, 3, 2)))
    opened = Mock(resting=rest, setup={"tracker": "lk"})
    with pytest.raises(UserError, match="tracker 'lk' does not estimate the covariances"):
        force_reading(Mock(), CAMERA_RULE, opened, Mock(), Mock())


def test_the_displacement_of_a_pad_is_that_of_its_deepest_markers() -> None:
    """Half the markers are pressed, by 0.2 mm, and pulled along; the others are not."""
    gains = DisplacementGains(
        log_size_per_mm=0.3, log_size_deviation=0.01,
        shift_px_per_mm=6.0, shift_px_per_mm2=-5.0, shift_deviation_px=0.02,
    )  # fmt: skip
    places = np.stack(np.meshgrid(np.arange(4.0), np.arange(5.0)), -1).reshape(1, -1, 2)
    pressed = np.arange(20) < 10
    rest = replace(Tracks.of_positions(0.0, places), log_size=np.zeros((1, 20)))
    shift = np.where(pressed, (6.0 - 5.0 * 0.2) * 0.1, 0.0)[None, :, None] * [1.0, -2.0]
    size = 0.3 * 0.2 * pressed[None]
    tracks = replace(Tracks.of_positions(0.1, places + shift), log_size=size)
    row = _displacement_row(gains, rest, tracks)
    assert row["depth_mm"] == pytest.approx(0.2)
    assert (row["shift_x_mm"], row["shift_y_mm"]) == pytest.approx((0.1, -0.2))
    assert row["deviation_mm"] == pytest.approx(0.01 / 0.3)
    assert row["marker_depth_mm"] == pytest.approx(0.2 * pressed)
    hidden = Tracks.of_positions(0.1, np.full_like(places, np.nan))
    assert "no marker of the outer layer" in str(_displacement_row(gains, rest, hidden))


@pytest.mark.data
def test_a_flat_pad_is_calibrated_and_read_by_its_displacements(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = load_scene("camera-100hz", {"sensor": "flat-2019"})
    sensor = scene.build_sensor()
    painter, skin = open_renderer("painter", sensor), MembraneMap(sensor, scene.fingertip.nodes)

    presses, frames, rest = (tmp_path / name for name in ("presses", "frames", "presses/rest.png"))
    save(rest, painter.render(skin(np.zeros((scene.fingertip.nodes, 2)))))
    known, asked = [(0.1, 0.0), (0.2, 0.2), (0.4, 0.2)], [(0.1, 0.05), (0.3, 0.15)]
    for folder, poses in ((presses, known), (frames, asked)):
        for k, (depth, shear) in enumerate(poses):
            pose = Pose(depth=1e-3 * depth, shear=1e-3 * shear)
            image = painter.render(skin(settle(scene, pose)[0].deformation.seen))
            add_noise(image, NOISE, len(poses), k)
            save(folder / f"{k}.png", image)
    lines = [f"{k}.png,{depth},{shear}\n" for k, (depth, shear) in enumerate(known)]
    (presses / "presses.csv").write_text("file,depth_mm,shear_mm\n" + "".join(lines))
    out, calibration = tmp_path / "out", tmp_path / "pad.toml"
    options: dict[str, Any] = {"tracker": "detect", "noise": NOISE}
    assert calibrate_sensor(presses, sensor="flat-2019", out=calibration, **options) == 0
    options["calibration"] = str(calibration)
    assert estimate(str(rest), str(frames), out=out, **options) == 0
    told = capsys.readouterr().out
    assert "displacement into the pad" in told
    assert "safety margin" not in told
    np.testing.assert_allclose(column(out, "depth_mm"), [0.1, 0.3], atol=0.02)
    np.testing.assert_allclose(column(out, "shift_x_mm"), [0.05, 0.15], atol=0.02)
    np.testing.assert_allclose(column(out, "shift_y_mm"), 0.0, atol=0.02)
    assert {"figure.png", "overlay.mp4"} <= {path.name for path in out.iterdir()}


def test_the_figure_has_true_curves_and_gaps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The middle frame has no estimate; its mark is at the edge and not at a value of 0."""
    drawn: list[Figure] = []

    def kept(figure: Figure, part: Path, dpi: int) -> None:
        drawn.append(figure)
        Path(part).touch()

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
