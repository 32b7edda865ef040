"""The commands on one's own pictures: `detect`, `track` and `estimate`."""

import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
import tyro
from rich.table import Table

from ..errors import UserError
from ..stored_pictures import MEGAPIXELS
from .options import (
    Crop,
    Flag,
    Fps,
    Frames,
    JsonOnly,
    Mask,
    MaxMegapixels,
    Noise,
    Out,
    Overwrite,
    Rest,
    SourceName,
    TrackerName,
    ValueRange,
    check_file,
    check_least,
    counting,
    new_folder,
    option,
    print_table,
    stem_of,
    value_table,
)
from .readouts import prepare

if TYPE_CHECKING:  # OpenCV loads only when something is detected
    from ..pictures.estimate import EstimateSummary
    from ..pictures.figure import Truth
    from ..pictures.find_sensor import Assumed, Within
    from ..pictures.following import Course
    from ..pictures.marker_list import Picture
    from ..pictures.opening import Setup
    from ..pictures.track import TrackSummary
    from ..scene.scene import Scene

#: Defaults of `chromagrip.tracking`, which is not imported before it is used.
_PALETTE = "auto"
_TRACKER = "fit"
_RECONSTRUCTOR = "auto"
PaletteName = Annotated[
    str,
    option(
        "colours of the markers: auto learns them from the picture; or a name of `chromagrip list "
        "palettes`, or a .toml file",
        "auto|NAME|FILE",
    ),
]


def detect(
    image: Annotated[Path, tyro.conf.Positional, option("picture of the sensor", "IMAGE")],
    *,
    palette: PaletteName = _PALETTE,
    crop: Crop = None,
    mask: Mask = None,
    out: Annotated[
        Path | None, option("file for a picture with the markers drawn in", "FILE.png")
    ] = None,
    save_palette: Annotated[
        Path | None, option("file for the palette that is found, to give to --palette", "FILE.toml")
    ] = None,
    overwrite: Annotated[Flag, option("overwrite earlier files")] = False,
    max_megapixels: MaxMegapixels = MEGAPIXELS,
    value_range: ValueRange = None,
    json_only: Annotated[
        Flag, option("print one JSON object with every marker", name="json")
    ] = False,
) -> int:
    """Find the markers of each layer in a single picture.

    Example: chromagrip detect press.png --out markers.png
    """
    check_least(max_megapixels=(max_megapixels, 0.0))
    if out is not None:
        check_file(out, {".png"}, overwrite)
    if save_palette is not None:
        check_file(save_palette, {".toml"}, overwrite)

    from ..pictures.find_sensor import save_palette as save_palette_file
    from ..pictures.marker_list import list_markers

    levels = _levels(value_range)
    within = _within(crop, mask, max_megapixels, levels)
    found = list_markers(image, palette, within, max_megapixels, levels)
    if out is not None:
        _save_picture(found, out)
    if save_palette is not None:
        save_palette_file(save_palette, found.palette, image.name)
    if json_only:
        height, width = found.image.shape[:2]
        report = {"image": str(image), "width_px": width, "height_px": height, **found.assumed}
        print(json.dumps({**report, "markers": found.rows}))
        return 0
    about = value_table()
    _add_assumed(about, found.assumed)
    print_table(about)
    table = Table(box=None, padding=(0, 2, 0, 0))
    for column in ("layer", "markers", "on the other layer's", "typical area", "typical hue"):
        table.add_column(column, justify="left" if column == "layer" else "right")
    for name, markers in zip(found.palette.names, found.layers, strict=True):
        pairs = sum(r["layer"] == name and r["pair"] is not None for r in found.rows)
        hues = np.radians(markers.hue[np.isfinite(markers.hue)])
        hue = math.degrees(math.atan2(np.sin(hues).sum(), np.cos(hues).sum()))
        table.add_row(
            name,
            str(len(markers.area)),
            str(pairs) if len(found.layers) > 1 else "–",
            f"{np.median(markers.area):.0f} px²" if len(markers.area) else "–",
            f"{hue:.0f}°" if len(hues) else "–",
        )
    print_table(table)
    print(f"picture {out}" if out else "see them with --out FILE.png, have them all with --json")
    return 0


def _levels(value_range: str | None) -> tuple[float, float] | None:
    """Values of black and white of pictures with more than 8 bits."""
    if value_range is None:
        return None
    try:
        black, white = map(float, value_range.split(","))
    except ValueError:
        black = white = math.nan
    if not -math.inf < black < white < math.inf:
        raise UserError(f"--value-range {value_range}: expected BLACK,WHITE, such as 0,65535")
    return black, white


def _within(
    crop: str | None, mask: Path | None, most: float, levels: tuple[float, float] | None
) -> "Within":
    from ..pictures.find_sensor import Within

    if crop is None:
        return Within(mask=mask, max_megapixels=most, value_range=levels)
    parts = crop.split(",")
    if len(parts) != 4 or not all(part.strip().isdecimal() for part in parts):
        raise UserError(f"--crop {crop}: expected left,top,width,height in pixels")
    left, top, width, height = map(int, parts)
    part = (left, top, width, height)
    return Within(crop=part, mask=mask, max_megapixels=most, value_range=levels)


def _save_picture(found: "Picture", path: Path) -> None:
    import cv2

    from ..pictures.overlay import draw_markers

    drawn = draw_markers(found.image, found.palette, found.layers)
    try:
        path.write_bytes(cv2.imencode(".png", drawn[..., ::-1])[1].tobytes())
    except OSError as error:
        raise UserError(f"picture {path} cannot be written: {error.strerror}") from None


def track(
    rest: Rest,
    source: SourceName,
    *,
    palette: PaletteName = _PALETTE,
    crop: Crop = None,
    mask: Mask = None,
    tracker: TrackerName = _TRACKER,
    noise: Noise = None,
    fps: Fps = None,
    frames: Frames = None,
    out: Out = None,
    overwrite: Overwrite = False,
    max_megapixels: MaxMegapixels = MEGAPIXELS,
    value_range: ValueRange = None,
    json_only: JsonOnly = False,
) -> int:
    """Follow the markers of a sensor through pictures, a video or a camera's frames.

    The folder has tracks.parquet (place of each marker in each frame in px), overlay.mp4 and
    summary.json.

    Example: chromagrip track rest.png press.mp4 --tracker lk
    """
    check_least(noise=(noise, 0.0), fps=(fps, 1e-3), frames=(frames, 1))
    check_least(max_megapixels=(max_megapixels, 0.0))
    levels = _levels(value_range)
    if out is None and not json_only:
        out = new_folder(f"track-{stem_of(source)}")

    from ..pictures.track import track_source

    with _frames("tracking") as (tell, progress):
        outcome = track_source(
            rest,
            source,
            palette=palette,
            within=_within(crop, mask, max_megapixels, levels),
            tracker=tracker,
            noise=noise,
            fps=fps,
            frames=frames,
            out=out,
            overwrite=overwrite,
            max_megapixels=max_megapixels,
            value_range=levels,
            tell=tell,
            progress=progress,
        )
    if json_only:
        print(json.dumps(outcome.summary))
    else:
        _print_summary(outcome.summary, out)
    if outcome.broken is not None:
        raise UserError(outcome.broken)
    return 0


def _print_summary(summary: "TrackSummary", folder: Path | None) -> None:
    table = value_table()
    _add_frames(table, summary)
    if summary["source_doubt"]:
        table.add_row("", summary["source_doubt"])
    table.add_row("rest frame", summary["rest"])
    _add_left_out(table, summary)
    if summary["rest_doubt"]:
        table.add_row("", f"{summary['rest_doubt']}: is it loaded, or a layer misplaced?")
    _add_assumed(table, summary)
    table.add_row("noise", f"{summary['noise_levels']:.2f} levels, {summary['noise_from']}")
    table.add_row("frame rate", f"{summary['fps']:g} Hz, {summary['fps_from']}")
    for name, layer in summary["layers"].items():
        share = layer["visible_share"]
        visible = "" if share is None else f", seen in {100 * share:.2f} % of the frames"
        table.add_row(name, f"{layer['markers']} markers{visible}")
    reasons = Counter(marker["reason"] for marker in summary["not_followed"])
    for k, (reason, count) in enumerate(reasons.items()):
        table.add_row("" if k else "seen at rest, not followed", f"{count}, {reason}")
    table.add_row("lost at the end", str(len(summary["lost"])))
    table.add_row("ambiguous", f"{summary['ambiguous']} times")
    if summary["ms_per_frame"] is not None:
        table.add_row("speed", f"{summary['ms_per_frame']:.1f} ms a frame, {summary['tracker']}")
    print_table(table)
    print(_seen_in(folder, "overlay.mp4"))


def _add_frames(table: Table, summary: "Course") -> None:
    """Rows of the frames that were read, and of those that did not come as they should."""
    from ..sources.delivery import in_words

    table.add_row("frames", f"{summary['frames']}, {summary['ended']}")
    if words := in_words(summary["delivery"]):
        table.add_row("", words)


def _add_left_out(table: Table, summary: "Setup") -> None:
    """Rows of the rest frames that are not used."""
    for each in summary["rest_left_out"]:
        table.add_row("left out at rest", f"{each['name']}: {each['because']}")


def _add_assumed(table: Table, found: "Assumed") -> None:
    """Rows of what a picture was taken to show."""
    if found["field_px"] is not None:
        left, top, width, height = found["field_px"]
        words = f"{width}×{height} px at ({left}, {top})"
        where = "found in what --crop or --mask leaves" if found["field_given"] else "found"
        table.add_row("sensor", f"{words}, {where}")
        table.add_row(
            "markers",
            f"radius {found['marker_radius_px']:.1f} px, {found['marker_distance_px']:.1f} px "
            f"apart, {'brighter' if found['bright'] else 'darker'} than the ground",
        )
    for name, dye in found["dyes"].items():
        shares = " ".join(f"{share:.2f}" for share in dye)
        source = "learned from the picture" if found["palette"] == _PALETTE else found["palette"]
        table.add_row(f"colour of {name}", f"{shares} of the ground's red, green, blue; {source}")


def estimate(
    rest: Rest,
    source: SourceName,
    *,
    calibration: Annotated[
        str,
        option(
            "sensor: file of `chromagrip calibrate sensor`, or a shipped sensor as designed",
            "NAME|FILE",
        ),
    ],
    reconstructor: Annotated[
        str,
        option(
            "reconstructor of forces, see `chromagrip list reconstructors`", "NAME|MODULE:CLASS"
        ),
    ] = _RECONSTRUCTOR,
    friction: Annotated[
        str | None,
        option(
            "estimator of µ from the forces, by default as in grasps",
            "max-ratio|core-quantile|read-out",
        ),
    ] = None,
    tracker: TrackerName = _TRACKER,
    window: Annotated[float, option("length in s of the moving average of µ", "S")] = 0.3,
    noise: Noise = None,
    fps: Fps = None,
    frames: Frames = None,
    out: Out = None,
    overwrite: Overwrite = False,
    max_megapixels: MaxMegapixels = MEGAPIXELS,
    value_range: ValueRange = None,
    publish: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option(
            "send each reading at once; may be repeated; a folder is then written only with --out",
            "jsonl:-|jsonl:FILE|mcap:FILE",
        ),
    ] = (),
    json_only: JsonOnly = False,
) -> int:
    """Estimate forces, friction and safety margin in pictures, a video or a camera's frames.

    The folder has estimates.parquet (values with 90 % intervals, frame by frame), figure.png,
    overlay.mp4 and summary.json. A flat pad has no force model: its displacements are estimated
    instead. For a sequence of a dataset the true values are printed next to the estimates, and its
    frame rate and body (chain or dome) are known.

    Example: chromagrip estimate rest.png press.mp4 --calibration mine.toml
    """
    check_least(window=(window, 1e-6), noise=(noise, 0.0), fps=(fps, 1e-3), frames=(frames, 1))
    check_least(max_megapixels=(max_megapixels, 0.0))
    levels = _levels(value_range)
    if out is None and not json_only and not publish:
        out = new_folder(f"estimate-{stem_of(source)}")

    from ..pictures.estimate import estimate_source
    from ..render import sensor_names
    from ..tracking import AUTOMATIC, load_calibration

    known = load_calibration(calibration)
    origin = _origin_of(source)
    if origin is not None:
        shown = origin.scene.sensor
        if known.name != shown and {known.name, shown} <= set(sensor_names()):
            raise UserError(
                f"calibration {known.name} is of another sensor than {source}, whose scene.toml "
                f"names {shown}"
            )
        fps = origin.scene.camera.rate_hz if fps is None and origin.timed else fps
        if reconstructor == _RECONSTRUCTOR and not known.sensor.shape.flat:
            reconstructor = AUTOMATIC[origin.scene.body]
    if not known.sensor.shape.flat:
        prepare(known, reconstructor)
    with _frames("estimating") as (tell, progress):
        outcome = estimate_source(
            rest,
            source,
            calibration=calibration,
            reconstructor=reconstructor,
            friction=friction,
            tracker=tracker,
            window=window,
            noise=noise,
            fps=fps,
            frames=frames,
            out=out,
            overwrite=overwrite,
            max_megapixels=max_megapixels,
            value_range=levels,
            truth=None if origin is None else origin.truth,
            publish=publish,
            tell=tell,
            progress=progress,
        )
    if json_only:
        print(json.dumps(outcome.summary))
    elif "jsonl:-" not in publish:  # whose lines are the output
        _print_estimates(outcome.summary, out)
    elif doubt := outcome.summary["reconstructor_doubt"]:
        print(f"chromagrip: {doubt}", file=sys.stderr)
    if outcome.broken is not None:
        raise UserError(outcome.broken)
    return 0


class _Origin(NamedTuple):
    """What is known of our own pictures: the scene, true values, and whether its rate is theirs."""

    scene: "Scene"
    truth: "Truth"
    timed: bool


def _origin_of(source: str) -> _Origin | None:
    """Scene and truth of a sequence of a dataset, a folder of `render`, a run's raw pictures.

    None for others.
    """
    folder = Path(source)
    kinds = {
        folder / "files.json": (_of_sequence, folder),
        folder / "poses.json": (_of_poses, folder),
        folder / "frames.csv": (_of_run, folder.parent),
    }
    kind, folder = next((kinds[path] for path in kinds if path.is_file()), (None, folder))
    if kind is None or not (folder / "scene.toml").is_file():
        return None
    try:
        return kind(folder)
    except UserError as error:
        print(f"chromagrip: true values are not shown: {error}", file=sys.stderr)
        return None


def _of_sequence(folder: Path) -> _Origin:
    from ..dataset.read import load_sequence

    found = load_sequence(folder)
    return _Origin(found.scene, found.frames, True)


def _of_poses(folder: Path) -> _Origin:
    from ..loop.poses.folder import true_values
    from ..scene import load_scene

    return _Origin(load_scene(str(folder / "scene.toml")), true_values(folder), False)


def _of_run(folder: Path) -> _Origin:
    from ..scene import load_scene

    # Its pictures have their own times.
    return _Origin(load_scene(str(folder / "scene.toml")), {}, False)


def _print_estimates(summary: "EstimateSummary", folder: Path | None) -> None:
    from ..output.parquet import VALUES
    from ..tracking.forces import pose_words

    frames, silent = summary["frames"], summary["without_estimate"]
    table = value_table()
    _add_frames(table, summary)
    table.add_row("frame rate", f"{summary['fps']:g} Hz, {summary['fps_from']}")
    if summary["source_doubt"]:
        table.add_row("", summary["source_doubt"])
    table.add_row("rest frame", f"{summary['rest']}, {summary['rest_misfit_px']:.2f} px off")
    _add_left_out(table, summary)
    if summary["scaled_by"] != 1.0:
        size = f"{summary['width_px']}×{summary['height_px']} px"
        table.add_row("size", f"{size}, scaled by {summary['scaled_by']:.3f} to the sensor's")
    if summary["camera_pose"]["notable"]:
        table.add_row("camera", pose_words(summary["camera_pose"]))
    table.add_row("noise", f"{summary['noise_levels']:.2f} levels, {summary['noise_from']}")
    if (method := summary["reconstructor"]) is not None:
        table.add_row("forces by", f"{method}{_meaning(method)}")
        if summary["reconstructor_doubt"]:
            table.add_row("", summary["reconstructor_doubt"])
    final = summary["last_estimate"]
    last_frame = frames and final == frames - 1
    at = "at the end" if last_frame else f"in frame {final}, the last with an estimate"
    for name, (words, unit) in VALUES.items():
        values = summary["estimates"].get(name)
        if values is not None:
            last = "–"
            if values["last"] is not None and values["last_interval"] is not None:
                low, high = values["last_interval"]
                last = f"{values['last']:z.3f}{unit} ({low:z.3f} … {high:z.3f})"
            table.add_row(words, f"{last} {at}, median {values['median']:z.3f}{unit}")
        if (true := summary["truth"].get(name)) is not None:
            kept, inside = f"true {true['last']:z.3f}{unit}", true["inside_interval"]
            share = "" if inside is None else f", inside in {inside:.0%} of the frames"
            table.add_row("", f"{kept}; RMS error {true['rms_error']:z.3f}{unit}{share}")
    if "mu" in summary["estimates"]:
        observable = summary["mu_observable_frames"]
        hint = "" if observable else ": the markers show no slip, so that µ and Γ are guesses"
        plural = "" if observable == 1 else "s"
        table.add_row("", "in brackets: 90 % intervals")
        table.add_row("", f"µ observable in {observable} frame{plural}{hint}")
    share = f", {silent / frames:.1%} of the frames" if frames else ""
    table.add_row("without estimate", f"{silent} of {frames}{share if silent else ''}")
    for reason, count in summary["without_estimate_because"].items():
        table.add_row("", f"{count}: {reason}")
    if frames:
        table.add_row(
            "speed",
            f"{summary['ms_per_frame']:.1f} ms a frame to track, "
            f"{summary['ms_per_estimate']:.1f} to estimate",
        )
    if summary["published"]:
        took, late = summary["late"]["reading_ms"], summary["late"]["late_frames"]
        if took is not None:
            table.add_row(
                "late",
                f"{took['median']:.1f} ms in the median, {took['p99']:.1f} ms in 99 %; {late} "
                f"longer than a frame lasts, {summary['skipped']} skipped",
            )
    print_table(table)
    print(_seen_in(folder, "figure.png", "overlay.mp4"))


def _meaning(method: str) -> str:
    """What a reconstructor of ours is, in brackets; empty for another's."""
    from ..tracking.forces import RECONSTRUCTORS

    _, words = RECONSTRUCTORS.entries.get(method, ("", ""))
    return f" ({words})" if words else ""


def _seen_in(folder: Path | None, *names: str) -> str:
    """Line that names a folder, and those of its pictures that are there."""
    there = [name for name in names if folder is not None and (folder / name).is_file()]
    if folder is None:
        return "nothing is written without --out"
    return f"folder {folder}, see {' and '.join(there)}" if there else f"folder {folder}"


@contextmanager
def _frames(text: str) -> Iterator[tuple[Callable[[str], None], Callable[[int, int | None], None]]]:
    """Bar of frames: functions that show the current step, and count a frame."""
    with counting("opening", "frames") as move:

        def count(done: int, total: int | None) -> None:
            move(done, total, text)

        yield (lambda step: move(0, None, step)), count
