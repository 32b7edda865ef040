"""The commands `calibrate camera`, `sensor` and `readout`."""

import json
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from ..calibrate.first_use import EPOCHS, HISTORIES, NOISE, as_designed, place_to_keep
from ..errors import UserError, located
from ..stored_pictures import MEGAPIXELS
from .options import (
    CORES,
    Flag,
    Json,
    MaxMegapixels,
    Noise,
    TrackerName,
    Workers,
    check_file,
    check_least,
    option,
    print_table,
    status,
    value_table,
)

if TYPE_CHECKING:  # OpenCV loads only when something is calibrated
    from ..calibrate.lens.folder import Calibration
    from ..render.optics import Board
    from ..tracking import SensorCalibration
    from ..tracking.forces import FitReport

#: File of the lens, unless another is named.
_DEFAULT_OUT = Path("calibration.yml")
#: File of the sensor, unless another is named.
_DEFAULT_SENSOR = Path("sensor-calibration.toml")


def calibrate_camera(
    images: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        option("pictures of the board, or folders of png and jpg files", "[IMAGE|DIR ...]"),
    ] = (),
    *,
    model: Annotated[
        Literal["fisheye", "pinhole"], option("model of the lens", "fisheye|pinhole")
    ] = "fisheye",
    columns: Annotated[int, option("number of squares of the board along x", "N")] = 9,
    rows: Annotated[int, option("number of squares of the board along y", "N")] = 6,
    square_mm: Annotated[float, option("side of a square in mm", "MM")] = 3.0,
    marker_mm: Annotated[float, option("side of a marker in mm", "MM")] = 2.2,
    dictionary: Annotated[str, option("set of markers, by its OpenCV name", "NAME")] = "4X4_100",
    out: Annotated[
        Path | None, option(f"calibration file; by default {_DEFAULT_OUT}", "FILE.yml")
    ] = None,
    overwrite: Annotated[Flag, option("overwrite an earlier file")] = False,
    max_megapixels: MaxMegapixels = MEGAPIXELS,
    print_board: Annotated[
        Path | None, option("write a picture of the board to print, and end", "FILE.png")
    ] = None,
    json_only: Annotated[
        Flag, option("print one JSON object; write a file only with --out", name="json")
    ] = False,
) -> int:
    """Calibrate a camera from pictures of a ChArUco board.

    Print the board with --print-board. `chromagrip calibrate sensor` calibrates the fingertip.

    Example: chromagrip calibrate camera photos --model fisheye --out camera.yml
    """
    from ..render.optics import Board

    check_least(max_megapixels=(max_megapixels, 0.0))
    board = Board(
        columns=columns,
        rows=rows,
        square=1e-3 * square_mm,
        marker=1e-3 * marker_mm,
        dictionary=dictionary,
    )
    if print_board is not None:
        return _print_board(board, print_board, overwrite, json_only)
    if out is None and not json_only:
        out = _DEFAULT_OUT
    if out is not None:
        check_file(out, {".yml", ".yaml"}, overwrite)

    from ..calibrate.lens.corners import image_files
    from ..calibrate.lens.folder import calibrate_camera
    from ..render import save_camera

    files = image_files(images)
    with status() as report:
        result = calibrate_camera(files, board, model, report, max_megapixels)
    if out is not None:
        save_camera(result.camera, out, result.error)
    if json_only:
        print(json.dumps(_report(result, model, out)))
    else:
        _print_result(result, model, out)
    return 0


def calibrate_sensor(
    presses: Annotated[
        Path,
        tyro.conf.Positional,
        option(
            "folder with rest*.png, pictures of presses, and presses.csv. Its columns are file, "
            "normal_n, lateral_n, torque_nmm, radius_mm (of a ball, 0 for a flat plate) for a dome "
            "of silicone; file, depth_mm, shear_mm for a flat pad",
            "PRESSES",
        ),
    ],
    *,
    sensor: Annotated[
        str,
        option("dome of silicone or flat pad to start from, such as dome-2022", "NAME|FILE.toml"),
    ],
    tracker: TrackerName = "fit",
    noise: Noise = None,
    out: Annotated[
        Path | None, option(f"calibration file; by default {_DEFAULT_SENSOR}", "FILE.toml")
    ] = None,
    overwrite: Annotated[Flag, option("overwrite an earlier file")] = False,
    max_megapixels: MaxMegapixels = MEGAPIXELS,
    json_only: Annotated[
        Flag, option("print one JSON object; write a file only with --out", name="json")
    ] = False,
) -> int:
    """Calibrate a dome of silicone, or a pad's displacements, from pictures of known presses.

    Of a dome (dome-2020, dome-2022) it estimates core, Young's modulus, Poisson's ratio and the
    depths of the layers in the silicone.

    Example: chromagrip calibrate sensor presses --sensor dome-2020 --out mine.toml
    """
    from ..render import load_sensor

    check_least(noise=(noise, 0.0), max_megapixels=(max_megapixels, 0.0))
    if out is None and not json_only:
        out = _DEFAULT_SENSOR
    if out is not None:
        check_file(out, {".toml"}, overwrite)
    design = load_sensor(sensor)

    from ..calibrate.sensor import calibrate_sensor as calibrate
    from ..calibrate.sensor import save_calibration
    from ..tracking.forces import calibration_table

    with status() as show:
        result, report = calibrate(
            presses,
            design,
            tracker=tracker,
            noise=noise,
            tell=show,
            max_megapixels=max_megapixels,
        )
    if out is not None:
        save_calibration(result, sensor, report, out)
    if json_only:
        print(json.dumps({**calibration_table(result, sensor, report), "out": out and str(out)}))
    else:
        _print_sensor(result, report, out)
    return 0


def _print_sensor(result: "SensorCalibration", report: "FitReport", out: Path | None) -> None:
    from msgspec.structs import asdict

    from ..tracking.forces import silicone_of

    table = value_table()
    table.add_row("presses", str(len(report.presses)))
    table.add_row("noise", f"{report.noise_levels:.2f} levels")
    silicone = silicone_of(result)
    for name, value in asdict(silicone).items() if silicone else ():
        if value is None:  # a layer on the core, of no depth of its own
            continue
        by = report.deviations.get(name)
        said = ", as designed" if by is None else f" ± {by:.2g}"
        if name in report.undetermined:
            said += ", as designed: these presses do not determine it"
        table.add_row(name, f"{value:.5g}{said}")
    for name, value in asdict(result.displacement).items() if result.displacement else ():
        table.add_row(name, "not measured" if value is None else f"{value:.4g}")
    table.add_row("markers miss by", f"{report.error_px:.3f} px RMS")
    if report.normal_error_share is not None:
        table.add_row("forces left by the fit", f"{report.normal_error_share:.1%} RMS normal")
    table.add_row("file", str(out))
    print_table(table)


def _print_board(board: "Board", path: Path, overwrite: bool, json_only: bool) -> int:
    """Write the board's picture, in its true size for programs that print."""
    from matplotlib.image import imsave

    from ..render.optics import board_picture

    check_file(path, {".png"}, overwrite)
    width, height = board.size
    printed = 300  # pixels of a square in the printed board: finer than printers print it
    per_inch = printed * 25.4e-3 / board.square
    try:
        imsave(path, board_picture(board, printed), cmap="gray", vmin=0, vmax=255, dpi=per_inch)
    except OSError as error:
        raise UserError(f"file {path} cannot be written: {error.strerror}") from None
    if json_only:
        print(json.dumps({"board": str(path), "width_mm": 1e3 * width, "height_mm": 1e3 * height}))
    else:
        print(
            f"{path}: {1e3 * width:g} × {1e3 * height:g} mm; print it at 100 % on matt paper, "
            f"leave a white margin, and glue it to something flat"
        )
    return 0


def _report(result: "Calibration", model: str, out: Path | None) -> dict[str, Any]:
    camera = result.camera
    return {
        "model": model,
        "width_px": camera.width,
        "height_px": camera.height,
        "focal_px": list(camera.focal),
        "centre_px": list(camera.centre),
        "distortion": list(camera.distortion),
        "standard_deviations": {
            "focal_px": list(result.deviations[:2]),
            "centre_px": list(result.deviations[2:4]),
            "distortion": list(result.deviations[4:]),
        },
        "rms_error_px": result.error,
        "corners": result.corners,
        "reach_deg": degrees(result.reach),
        "used": [{"image": name, "rms_error_px": e} for name, e in result.images.items()],
        "left_out": [{"image": name, "reason": why} for name, why in result.left_out.items()],
        "out": None if out is None else str(out),
    }


def _print_result(result: "Calibration", model: str, out: Path | None) -> None:
    camera, spread = result.camera, result.deviations

    def pair(values: tuple[float, float], first: int) -> str:
        x, y = values
        return f"{x:.2f} ± {spread[first]:.2f}, {y:.2f} ± {spread[first + 1]:.2f} px"

    worst = max(result.images, key=lambda name: result.images[name])
    table = value_table()
    table.add_row("model", f"{model}, {camera.width}×{camera.height} px")
    table.add_row("images used", f"{len(result.images)}, {result.corners} corners")
    for name, reason in result.left_out.items():
        table.add_row("left out", f"{name}: {reason}")
    table.add_row("corners reach", f"{degrees(result.reach):.0f}° from the axis")
    table.add_row("focal", pair(camera.focal, 0))
    table.add_row("centre", pair(camera.centre, 2))
    names = ("k1", "k2", "k3", "k4") if model == "fisheye" else ("k1", "k2", "p1", "p2", "k3")
    for name, value, by in zip(names, camera.distortion, spread[4:], strict=True):
        text = f"{value:.5f} ± {by:.5f}" if by > 0.0 else "0, the images do not determine it"
        table.add_row(name, text)
    table.add_row("error, RMS", f"{result.error:.3f} px")
    table.add_row("worst image", f"{result.images[worst]:.3f} px, {worst}")
    table.add_row("file", str(out))
    print_table(table)


def calibrate_readout(
    calibration: Annotated[
        str,
        tyro.conf.Positional,
        option("sensor as designed, or the .toml file of its calibration", "SENSOR|FILE.toml"),
    ],
    *,
    out: Annotated[
        Path | None,
        option(
            "file of the read-out, to be named in a calibration; by default a file in the user's "
            "cache folder, which every command finds by the sensor's design",
            "FILE.npz",
        ),
    ] = None,
    noise: Annotated[
        float, option("standard deviation of the camera noise in levels of 0 to 255", "LEVELS")
    ] = NOISE,
    histories: Annotated[int, option("number of random grips to learn from", "N")] = HISTORIES,
    epochs: Annotated[int, option("number of passes over the grips", "N")] = EPOCHS,
    workers: Workers = CORES,
    overwrite: Annotated[Flag, option("overwrite an earlier file")] = False,
    json_only: Json = False,
) -> int:
    """Train a read-out of forces and friction on random grips of a sensor's own model.

    Commands that need a read-out train it by themselves, with these defaults. Fewer grips and
    passes, as in the example, give a rough one. An interrupted run continues when it is called
    again.

    Example: chromagrip calibrate readout mine.toml --histories 500 --epochs 2 --out mine.npz
    """
    check_least(histories=(histories, 500), epochs=(epochs, 1), workers=(workers, 1))
    if not 0.1 <= noise <= 50.0:
        raise UserError(f"--noise {noise:g}: expected 0.1 to 50 levels")
    if out is not None:
        check_file(out, {".npz"}, overwrite)

    from ..calibrate.readout import train as learn
    from ..tracking import load_calibration
    from ..tracking.forces import check_trainable

    known, file = load_calibration(calibration), out
    check_trainable(known)
    if file is None:
        file = _free_place(known, overwrite)
        known = as_designed(known)
    with located(f"sensor {calibration}"), status() as report:
        errors = learn(known, noise, histories, epochs, file, workers, report)
    if json_only:
        print(json.dumps({"readout": str(file), "histories": histories, "errors": errors}))
        return 0
    print(
        f"error on histories outside the training: {errors['margin']:.3f} of Γ and "
        f"{100 * errors['mu']:.0f} % of µ, RMS over all noise levels"
    )
    if out is None:
        print(f"read-out {file}, kept for every use of this design")
    else:
        print(f"read-out {out}, name it in a calibration as readout = {out.name!r}")
    return 0


def _free_place(known: "SensorCalibration", overwrite: bool) -> Path:
    """Where the read-out of a design is kept, if it is looked for there and may be written."""
    path = place_to_keep(known)
    if known.readout not in (None, path):
        raise UserError(
            f"a kept read-out would not be used: there is {known.readout}, which comes first; give "
            "--out FILE.npz"
        )
    if path.exists() and not overwrite:
        raise UserError(f"a read-out of this design is kept in {path}; give --overwrite")
    return path
