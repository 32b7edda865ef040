"""The middle of the thesis' sensor: small pictures, and where the markers truly are."""

from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.spatial import KDTree

from chromagrip.model import Fingertip
from chromagrip.render import Frame, Membrane, MembraneMap, add_noise, load_sensor, open_renderer
from chromagrip.render.outlines import centroids, outlines
from chromagrip.tracking import Palette, Tracks

Image = NDArray[np.uint8]
#: Side of the pictures [px], of which the camera shows the middle.
SIDE = 280
THESIS = load_sensor("thesis")
SENSOR = replace(
    THESIS,
    camera=replace(THESIS.camera, width_px=SIDE, height_px=SIDE),
    layout=replace(THESIS.layout, count=99, coverage_deg=40.0),
)
PALETTE = Palette.of_sensor(SENSOR)
PAINTER = open_renderer("painter", SENSOR)
TIP = Fingertip()
NOISE = 2.0
PLACES = SENSOR.places
#: Displacements of the nodes under 3 N and 1.08 N across, and under 2 N and 0.5 N [m].
PRESSES = np.load(Path(__file__).parents[2] / "fixtures/path-traced/seen.npz")
FIRM, LIGHT = PRESSES["013"].astype(float), PRESSES["006"].astype(float)


#: The membrane where the nodes are displaced by so much (N, 2) [m].
carried = MembraneMap(SENSOR, TIP.nodes)
REST = carried(np.zeros((TIP.nodes, 2)))


def moved(by: np.ndarray, layer: int | None = None, of: np.ndarray | None = None) -> Membrane:
    """Markers at rest, of one layer or both and some or all, moved by so much [m]."""
    centres = REST.centres.copy()
    layers = [0, 1] if layer is None else [layer]
    markers = np.arange(centres.shape[1]) if of is None else of
    centres[np.ix_(layers, markers)] += by
    return Membrane(centres=centres, axes=REST.axes)


def noisy(image: Image, index: int) -> Frame:
    image = image.copy()
    add_noise(image, NOISE, 11, index)
    return Frame(image=image, time=0.01 * index)


def shoot(membrane: Membrane, index: int) -> Frame:
    return noisy(PAINTER.render(membrane), index)


def image_centres(membrane: Membrane) -> np.ndarray:
    """Where the middle of each marker's image is [px], shape (2, M, 2)."""
    return centroids(outlines(membrane, SENSOR.view), square=False)


def numbers(rest: Tracks) -> np.ndarray:
    """Which marker each tracked pair is, by its place at rest."""
    at = np.where(rest.visible[0][:, None], rest.position[0], rest.position[1])
    return np.asarray(KDTree(image_centres(REST)[0]).query(np.nan_to_num(at))[1])
