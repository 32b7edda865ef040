"""The painter against pictures of a path tracer, which a checkout holds in fixtures/.

Both pictures are measured in the same way: densities of the two dyes over the ground of the
renderer's picture at rest, then the thresholded centre of mass of each marker. The discs throw soft
shadows on the skin, of up to a quarter of a dye's density, which the painter does not draw. The
threshold leaves them out; the centres of mass with them are reported too.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.render.judge import colour_difference
from chromagrip.model import SoftBody
from chromagrip.output.report import Row, at_most, reported
from chromagrip.render import (
    Membrane,
    SensorDesign,
    TruthMap,
    decode_srgb,
    encode_srgb,
    ground_image,
    load_sensor,
    outlines,
    rest_membrane,
)
from chromagrip.render.drawing import Painter
from chromagrip.sensing.camera import map_of
from chromagrip.tracking import Palette, dye_densities, resting_ground, unmixing_matrix

Array = NDArray[np.float64]


class Entry(TypedDict):
    """One traced picture.

    Attributes
    ----------
    sensor, file: names
    crop: where the file's picture lies in the image [px]
    grip: on the chain [N]; 0 is at rest
    body: `dome` where it is not the chain
    """

    sensor: str
    file: str
    crop: tuple[int, int]
    grip: float | None
    body: NotRequired[str]


#: Folder of the pictures.
FOLDER = Path(__file__).resolve().parents[2] / "fixtures" / "path-traced"
#: Range of densities that count towards a centre, without shadows.
_THRESHOLDED = (0.25, 0.75)
#: Range of all densities.
_PLAIN = (0.0, 1.2)
#: A marker's pixels are those up to this beyond its outline that no other marker is nearer to [px].
_MARGIN = 3.0


def against_path_traced(quick: bool) -> list[Row]:
    """Rows of the comparison, for the camera at the sphere centre and for one below it.

    The first has pictures of both bodies.
    """
    book: dict[str, Entry] = json.loads((FOLDER / "poses.json").read_text("utf-8"))["pictures"]
    rows = []
    kinds = dict.fromkeys((entry["sensor"], entry.get("body", "chain")) for entry in book.values())
    for name, body in kinds:
        mine = {k: entry for k, entry in book.items() if entry["sensor"] == name}
        rest = next(entry for entry in mine.values() if entry["grip"] == 0.0)
        posed = {
            k: entry
            for k, entry in mine.items()
            if entry["grip"] != 0.0 and entry.get("body", "chain") == body
        }
        centres, plain, colours = _compare(name, rest, posed, quick)
        label = {"chain": Path(name).stem}.get(body, body)
        case = ("painter_against_path_tracer", label)
        rms = np.sqrt(np.nanmean(centres**2, axis=(0, 2, 3)))
        rows += [
            at_most((*case, "magenta_centres"), rms[0], "px", 0.2),
            at_most((*case, "yellow_centres"), rms[1], "px", 0.2),
            reported((*case, "worst_marker"), np.nanmax(abs(centres)), "px"),
            reported((*case, "centres_with_shadows"), np.sqrt(np.nanmean(plain**2)), "px"),
            at_most((*case, "overlap_colour"), colours.mean(), "ΔE2000", 6.0),
        ]
        if name != "thesis":
            ignored = _without_refraction(load_sensor(str(FOLDER / name)))
            rows.append(reported((*case, "if_refraction_were_ignored"), ignored, "px"))
    return rows


def _compare(
    name: str,
    resting: Entry,
    pictures: dict[str, Entry],
    quick: bool,
) -> tuple[Array, Array, Array]:
    """Differences of centres, thresholded and plain (poses, 2, M, 2) [px], and of colours."""
    sensor = load_sensor(name if name == "thesis" else str(FOLDER / name))
    painter = Painter(sensor)
    bare = ground_image(sensor).astype(float)
    palette = Palette.of_sensor(sensor)
    traced_ground = resting_ground(_traced(sensor, resting), palette)
    painted_ground = resting_ground(painter.render(rest_membrane(sensor)), palette)
    centres: list[Array] = []
    plain: list[Array] = []
    colours: list[Array] = []
    keys = list(pictures)
    # The third of the chain's is the strongest.
    for key, membrane, masks in _posed(sensor, pictures, keys[2:3] if quick else keys):
        traced, painted = _traced(sensor, pictures[key]), painter.render(membrane)
        for differences, levels in ((centres, _THRESHOLDED), (plain, _PLAIN)):
            differences.append(
                _mass_centres(sensor, membrane, traced, traced_ground, levels)
                - _mass_centres(sensor, membrane, painted, painted_ground, levels)
            )
        # Flat-fielded, as a laboratory does it: each picture over its own resting ground.
        flat = decode_srgb(traced.astype(float)) / traced_ground * bare
        both = masks.min(axis=0) > 0.99
        colours.append(colour_difference(encode_srgb(flat[both]), painted[both].astype(float)))
    return np.stack(centres), np.stack(plain), np.concatenate(colours)


def _posed(
    sensor: SensorDesign, pictures: dict[str, Entry], keys: list[str]
) -> Iterator[tuple[str, Membrane, NDArray[np.float32]]]:
    """Membrane and masks of pictures by their names."""
    body = pictures[keys[0]].get("body", "chain")
    with np.load(FOLDER / {"chain": "seen.npz", "dome": "dome.npz"}[body]) as kept:
        drives = {key: kept[key].astype(float) for key in keys}
    nodes = len(drives[keys[0]])
    carriers: dict[str, Callable[[], int | SoftBody]]
    carriers = {"chain": lambda: nodes, "dome": lambda: sensor.dome}
    carrier = carriers[body]()
    membrane_map, truth_map = map_of(sensor, carrier, None), TruthMap(sensor, carrier)
    for key, drive in drives.items():
        membrane = membrane_map(drive)
        yield key, membrane, truth_map.images(["masks"], membrane, drive)["masks"]


def _traced(sensor: SensorDesign, entry: Entry) -> NDArray[np.uint8]:
    """Picture as large as the camera's, black outside the stored part."""
    image = np.zeros((sensor.view.height, sensor.view.width, 3), dtype=np.uint8)
    stored: Any = cv2.imread(str(FOLDER / entry["file"]))
    part = cv2.cvtColor(stored, cv2.COLOR_BGR2RGB)
    x, y = entry["crop"]
    image[y : y + part.shape[0], x : x + part.shape[1]] = part
    return image


def _mass_centres(
    sensor: SensorDesign,
    membrane: Membrane,
    image: NDArray[np.uint8],
    ground: Array,
    levels: tuple[float, float],
) -> Array:
    """Centre of mass of each marker's dye in the image [px], shape (2, M, 2).

    The weight of a pixel is its density above the first level, up to the second.
    """
    linear = decode_srgb(image.astype(float))
    densities = dye_densities(linear, ground, unmixing_matrix(sensor.transmittance))
    shapes = outlines(membrane, sensor.view)
    centre = np.full((2, len(sensor.places), 2), np.nan)
    for layer in range(2):
        places = shapes[layer, :, 0]
        for m, place in enumerate(places):
            reach = np.linalg.norm(shapes[layer, m, 1:3], axis=-1).max() + _MARGIN
            low, high = np.floor(place - reach).astype(int), np.ceil(place + reach).astype(int) + 1
            if (low < 0).any() or (high > [image.shape[1], image.shape[0]]).any():
                continue
            y, x = np.mgrid[low[1] : high[1], low[0] : high[0]]
            pixels = np.stack([x, y], axis=-1)
            near = places[np.linalg.norm(places - place, axis=-1) < 3 * reach]
            own = np.linalg.norm(pixels - place, axis=-1)
            others = np.linalg.norm(pixels[..., None, :] - near, axis=-1).min(axis=-1)
            density = densities[layer, low[1] : high[1], low[0] : high[0]]
            weight = np.clip(density, *levels) - levels[0]
            weight = np.where((own < reach) & (own <= others + 1e-9), weight, 0.0)
            if weight.sum() > 1.0:
                centre[layer, m] = (weight[..., None] * pixels).sum(axis=(0, 1)) / weight.sum()
    return centre


def _without_refraction(sensor: SensorDesign) -> float:
    """RMS error of the markers' positions if the silicone had the index of air [px]."""
    points = rest_membrane(sensor).centres
    straight = replace(sensor.view, index=1.0)
    off = sensor.view.project(points) - straight.project(points)
    return float(np.sqrt((off**2).mean()))
