"""Checks of a sensor design: markers must not overlap, and must lie in the image."""

import numpy as np
import scipy
from numpy.typing import NDArray

from ...errors import UserError
from ..optics.view import View
from .skin import Skin

Array = NDArray[np.float64]


def check_markers(
    shape: Skin,
    view: View,
    places: Array,
    depths: Array,
    half_sizes: Array,
    square: bool,
) -> None:
    """Check the layout of a design.

    Parameters
    ----------
    shape: shape of the skin
    view: view of the camera
    places: places of the markers on the skin, shape (n, 2)
    depths, half_sizes: depths and half sizes of the L layers, magenta first [m], shape (L,)
    square: whether markers are squares, not discs

    Raises
    ------
    UserError
        When markers of a layer overlap, leave the skin, or lie outside the image.
    """
    layers = zip(("magenta", "yellow"), depths, half_sizes, strict=False)
    for name, depth, half in layers:
        points = shape.points(places, depth)
        outside = np.flatnonzero(shape.rim_distance(places) <= 0.0)
        if len(outside):
            raise UserError(
                f"layout: {len(outside)} markers, the first number {outside[0]}, lie off the skin"
            )
        # Discs touch at a distance of their diameter; parallel squares if both sides overlap.
        order = np.inf if square else 2
        close = scipy.spatial.KDTree(points).query_pairs(2 * half * np.sqrt(2.0))
        for i, j in sorted(close):
            along, across = shape.tangents(places[i])
            gap = points[j] - points[i]
            turned = _turn(places[i]) @ np.array([gap @ along, gap @ across])
            apart = np.linalg.norm([*turned, gap @ np.cross(along, across)], order)
            if apart < 2 * half:
                raise UserError(
                    f"layout: {name} markers {i} and {j} overlap: {apart * 1e3:.3g} mm apart, "
                    f"{2e3 * half:.3g} mm in size"
                )
        pixels = view.project(points)
        size = np.array([view.width, view.height])
        inside = np.asarray(((pixels > 0.0) & (pixels < size - 1.0)).all(axis=-1))
        if not inside.any():
            raise UserError("camera: it sees none of the markers")
        if not inside.all():
            first = np.flatnonzero(~inside)[0]
            raise UserError(
                f"layout: {(~inside).sum()} of {len(inside)} {name} markers, the first number "
                f"{first}, lie outside the {size[0]}×{size[1]} image"
            )


def _turn(place: Array) -> Array:
    """Rotation from the axes along (first coordinate, φ) to the sensor's x and y."""
    cos, sin = np.cos(place[1]), np.sin(place[1])
    return np.array([[cos, -sin], [sin, cos]])
