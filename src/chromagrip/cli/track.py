"""The commands `detect`, `track`, `trackers` and `palettes`."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from ..errors import UserError
from .options import (
    Flag,
    Force,
    Fps,
    Frames,
    JsonOnly,
    Noise,
    Out,
    Rest,
    SourceName,
    TrackerName,
    check_least,
    frame_progress,
    new_folder,
    option,
)

if TYPE_CHECKING:  # OpenCV loads only when something is detected
    from ..pictures.marker_list import Picture

# As in tracking, which is not imported before it is used.
_PALETTE, _TRACKER = "chromatouch", "fit"
PaletteName = Annotated[
    str,
    option("palette or sensor, see `chromagrip palettes`, or a .toml file of either", "NAME|FILE"),
]


def detect(
    image: Annotated[Path, tyro.conf.Positional, option("picture of the sensor", "IMAGE")],
    *,
    palette: PaletteName = _PALETTE,
    out: Annotated[Path | None, option("picture with the markers drawn in", "FILE.png")] = None,
    force: Annotated[Flag, option("write over an earlier picture")] = False,
    json_only: Annotated[Flag, option("one JSON object with every marker", name="json")] = False,
) -> int:
    """Find the markers of each layer in a single picture."""
    if out is not None:
        _check_picture(out, force)

    from ..pictures.marker_list import list_markers

    found = list_markers(image, palette)
    if out is not None:
        _save_picture(found, out)
    if json_only:
        height, width = found.image.shape[:2]
        report = {"image": str(image), "palette": palette, "width_px": width, "height_px": height}
        print(json.dumps({**report, "markers": found.rows}))
        return 0
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
    Console(markup=False, highlight=False).print(table)
    print(f"picture {out}" if out else "see them with --out FILE.png, have them all with --json")
    return 0


def _check_picture(path: Path, force: bool) -> None:
    """Refuse before the work what could not be written after it."""
    if path.suffix.lower() != ".png":
        raise UserError(f"picture {path} must end in .png")
    if not path.parent.is_dir():
        raise UserError(f"picture {path} cannot be written: there is no folder {path.parent}")
    if path.is_dir() or (path.exists() and not force):
        raise UserError(f"picture {path} exists; choose another or give --force")


def _save_picture(found: "Picture", path: Path) -> None:
    import cv2

    from ..pictures.overlay import draw_markers

    places = [markers.position for markers in found.layers]
    areas = [markers.area for markers in found.layers]
    drawn = draw_markers(found.image, found.palette, places, areas)
    try:
        path.write_bytes(cv2.imencode(".png", drawn[..., ::-1])[1].tobytes())
    except OSError as error:
        raise UserError(f"picture {path} cannot be written: {error.strerror}") from None


def track(
    rest: Rest,
    source: SourceName,
    *,
    palette: PaletteName = _PALETTE,
    tracker: TrackerName = _TRACKER,
    noise: Noise = None,
    fps: Fps = None,
    frames: Frames = None,
    out: Out = None,
    force: Force = False,
    json_only: JsonOnly = False,
) -> int:
    """Follow the markers of a sensor through pictures, a video or a camera's frames.

    Leaves tracks.parquet (where each marker was in each frame), overlay.mp4 and summary.json.
    """
    check_least(noise=(noise, 0.0), fps=(fps, 1e-3), frames=(frames, 1))
    if out is None and not json_only:
        out = new_folder(f"track-{Path(source).stem.replace(':', '-')}")

    from ..pictures.track import track_source

    with frame_progress("tracking") as (tell, progress):
        outcome = track_source(
            rest,
            source,
            palette=palette,
            tracker=tracker,
            noise=noise,
            fps=fps,
            frames=frames,
            out=out,
            force=force,
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


def _print_summary(summary: dict[str, Any], folder: Path | None) -> None:
    table = Table(show_header=False, box=None, padding=(0, 2))
    table.add_row("frames", f"{summary['frames']}, {summary['ended']}")
    table.add_row("rest frame", summary["rest"])
    table.add_row("noise", f"{summary['noise_levels']:.2f} levels, {summary['noise_from']}")
    table.add_row("frame rate", f"{summary['fps']:g} Hz")
    for name, layer in summary["layers"].items():
        share = layer["visible_share"]
        seen = "" if share is None else f", seen in {100 * share:.2f} % of the frames"
        table.add_row(name, f"{layer['markers']} markers{seen}")
    table.add_row("lost at the end", str(len(summary["lost"])))
    table.add_row("ambiguous", f"{summary['ambiguous']} times")
    if summary["ms_per_frame"] is not None:
        table.add_row("speed", f"{summary['ms_per_frame']:.1f} ms a frame, {summary['tracker']}")
    Console(markup=False, highlight=False).print(table)
    print(f"folder {folder}, see overlay.mp4")


def trackers() -> int:
    """List the trackers, also those of installed packages."""
    from ..tracking import tracker_names

    return _list(tracker_names())


def palettes() -> int:
    """List the palettes; every sensor design is one too."""
    from ..render import load_sensor, sensor_names
    from ..tracking import load_palette, palette_names

    shipped = {}
    for name in palette_names():
        palette = load_palette(name)
        layers = " over ".join(palette.names)
        shipped[name] = f"{layers}, {'brighter' if palette.bright else 'darker'} than the ground"
    designs = {name: f"sensor, {load_sensor(name).description}" for name in sensor_names()}
    return _list(shipped | designs)


def _list(entries: dict[str, str]) -> int:
    width = max(map(len, entries))
    for name, text in entries.items():
        print(f"{name:<{width}}  {text}")
    return 0
