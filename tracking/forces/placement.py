"""Location of the design's image in a picture that was scaled, cropped or padded."""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import UserError
from ...render import SensorDesign
from .pose import CameraPose
from .rest_match import RestMarkers, Shift, markers_beside, spacing
from .rest_search import likely_poses
from .rest_settings import PlacementSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Placement:
    """Location of the design's image in a picture; pixel centres have integer coordinates.

    A roll about the optical axis is no part of it, but of the camera's pose.

    Attributes
    ----------
    scale: pixels of the picture per pixel of the design's image
    corner: centre of the upper left pixel of the design's image [px of the picture]
    share: share of the markers in the picture that lie at marker positions of the design
    """

    scale: float
    corner: tuple[float, float]
    share: float


def placement(
    sensor: SensorDesign,
    seen: list[Array],
    size: tuple[int, int],
    settings: PlacementSettings = PlacementSettings(),
) -> Placement:
    """Find the design's image in a picture of the unloaded sensor.

    Parameters
    ----------
    sensor: design of the sensor
    seen: pixels of the n markers in each layer, (n, 2)
    size: width and height of the picture [px]

    Raises
    ------
    UserError
        When no location puts enough markers at marker positions of the design.
    """
    lens = sensor.view.camera.lens
    axis = np.array([lens.centre_x, lens.centre_y])
    outer = sensor.view.project(sensor.shape.points(sensor.places, sensor.depths[0]))
    scale, here, there = spacing(seen[0]) / spacing(outer), seen[0].mean(axis=0), outer.mean(axis=0)
    reach = float(np.median(np.linalg.norm(outer - there, axis=-1)))
    best = None
    for middle in settings.middles:
        # The search covers only small shifts and scales: start from an approximate location.
        start = there + reach * np.array(middle)
        near = [start + (pixels - here) / scale for pixels in seen]
        markers = markers_beside(sensor, near, settings.match)
        edges = start + (np.array([[0.0, 0.0], size]) - 0.5 - here) / scale
        found = _best(markers, edges, settings)
        if found is not None and (best is None or found[1] > best.share):
            pose, share = found
            zoom = scale * pose.scale
            on_axis = here + scale * (axis + np.asarray(pose.shift) - start)
            left, top = map(float, on_axis - zoom * axis)
            best = Placement(scale=zoom, corner=(left, top), share=share)
        if best is not None and best.share >= settings.share:
            return best
    raise UserError(
        f"{100 * (0.0 if best is None else best.share):.0f} % of the "
        f"{sum(len(pixels) for pixels in seen)} markers in the picture lie at places of the "
        f"calibrated sensor, however it is scaled, turned and shifted; allowed: at least "
        f"{100 * settings.share:.0f} %. Is it another sensor, or is much of it cut off?"
    )


def _best(
    markers: RestMarkers, edges: Array, settings: PlacementSettings
) -> tuple[CameraPose, float] | None:
    """Find the pose that fits the markers best, and the share of them that it fits.

    Parameters
    ----------
    markers: markers in the scale of the design
    edges: upper left and lower right corner of the picture [px], shape (2, 2)
    """
    scored = []
    for pose in likely_poses(markers, settings.search):
        share, overlap, moved = _scores(markers, pose, edges)
        scored.append((overlap, moved, share, pose))
    if not scored:
        return None
    least = max(scored)[0] - settings.equal / np.sqrt(len(markers.sensor.places))
    _, _, share, pose = min((one for one in scored if one[0] >= least), key=lambda one: one[1])
    return pose, share


def _scores(markers: RestMarkers, pose: CameraPose, edges: Array) -> tuple[float, float, float]:
    """Share of markers at design positions, overlap of both, and RMS motion from there [px]."""
    limit, edge = markers.same * markers.pitch * pose.scale, 0.5 * markers.pitch
    near = seen = met = expected = 0
    moved = 0.0
    for k, (layer, places) in enumerate(
        zip(markers.layers, markers.seen(pose, Shift()), strict=True)
    ):
        distance = np.asarray(scipy.spatial.KDTree(places).query(layer.pixels)[0])
        near, seen = near + int((distance < limit).sum()), seen + len(distance)
        there = ((places > edges[0] + edge) & (places < edges[1] - edge)).all(axis=-1)
        reached = np.asarray(layer.tree.query(places[there])[0]) < limit
        met, expected = met + int(reached.sum()), expected + len(reached)
        moved += float(np.linalg.norm(places - markers.designed(k), axis=-1).mean())
    return near / seen, (near + met) / (seen + expected), moved
