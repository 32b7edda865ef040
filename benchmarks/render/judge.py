"""Differences between two pictures: colours, and centres of the markers."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from chromagrip.extras import need
from chromagrip.model import ContactObject, Fingertip, equilibrium
from chromagrip.render import Membrane, SensorDesign, centroids, decode_srgb, outlines

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

#: Distance beyond a marker's radius within which its whole image lies [px].
_MARGIN = 5.0


def colour_difference(first: Array | Image, second: Array | Image) -> Array:
    """CIEDE2000 between sRGB levels 0…255, shape (…, 3) to (…)."""
    color = need("skimage.color", "images")
    first_lab, second_lab = color.rgb2lab(first / 255.0), color.rgb2lab(second / 255.0)
    return np.asarray(color.deltaE_ciede2000(first_lab, second_lab))


def poses_of(sensor: SensorDesign, nodes: int = 251) -> list[tuple[str, Array]]:
    """Name and node displacements (N, 2) [m] of a few poses: rest, pressed, pressed and sheared."""
    tip = Fingertip.of_radius(sensor.shape.radius, nodes=nodes, law="split")
    ball = ContactObject(curvature=50.0, friction=0.7)
    states = [equilibrium(tip, ContactObject(), 3.0, 0.8), equilibrium(tip, ball, 5.0, 2.0)]
    flat, round_ = (state.deformation.seen for state in states)
    return [("rest", np.zeros((nodes, 2))), ("flat", flat), ("ball", round_)]


def layer_centroids(
    render: Callable[[Membrane], Image], sensor: SensorDesign, membrane: Membrane, ground: Image
) -> Array:
    """Intensity centroid of each marker's noise-free image [px], shape (2, M, 2).

    The layers are drawn one at a time, and in each picture only markers far from each other, so
    that the window of a marker holds all of its image and nothing else.
    """
    expected = centroids(outlines(membrane, sensor.view), sensor.markers.form == "square")
    bare = decode_srgb(ground.astype(float))
    measured = np.full_like(expected, np.nan)
    for layer in range(2):
        channel = int(np.argmin(sensor.transmittance[layer]))
        radius = _image_radius(sensor, membrane, layer)
        for group in _groups(expected[layer], 2.0 * (radius.max() + _MARGIN)):
            alone = np.full_like(membrane.centres, np.nan)
            alone[layer, group] = membrane.centres[layer, group]
            image = render(Membrane(centres=alone, axes=membrane.axes))
            dark = 1.0 - decode_srgb(image[..., channel].astype(float)) / bare[..., channel]
            for m in group:
                measured[layer, m] = _centroid(dark, expected[layer, m], radius[m] + _MARGIN)
    return measured


def _image_radius(sensor: SensorDesign, membrane: Membrane, layer: int) -> Array:
    axes = outlines(membrane, sensor.view)[layer, :, 1:3]
    return np.asarray(np.linalg.norm(axes, axis=-1).max(axis=-1)) * (
        np.sqrt(2.0) if sensor.markers.form == "square" else 1.0
    )


def _groups(centres: Array, apart: float) -> list[list[int]]:
    """Markers sorted into groups whose members lie at least so far apart."""
    groups: list[list[int]] = []
    for m, centre in enumerate(centres):
        for group in groups:
            if (np.linalg.norm(centres[group] - centre, axis=-1) > apart).all():
                group.append(m)
                break
        else:
            groups.append([m])
    return groups


def _centroid(dark: Array, near: Array, radius: float) -> Array:
    """Centre of mass of an image within a square window; NaN if the image's edge cuts it."""
    low = np.floor(near - radius).astype(int)
    high = np.ceil(near + radius).astype(int) + 1
    if (low < 0).any() or (high[::-1] > dark.shape).any():
        return np.full(2, np.nan)
    part = dark[low[1] : high[1], low[0] : high[0]]
    y, x = np.mgrid[low[1] : high[1], low[0] : high[0]]
    return np.array([(part * x).sum(), (part * y).sum()]) / part.sum()
