"""A frame with its labels, and the labels that do not depend on the body."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...loop.sample import Sample
from ...model import GROSS_SLIP
from ...render import MarkerTruth
from ...sensing.sensor import SLIPPING as SLIPPING
from .columns import COMMON, MARKERS

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Image = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A frame with its labels.

    Attributes
    ----------
    image: picture of the camera, RGB, shape (H, W, 3)
    values: values of the frame, by column
    markers: values of the markers, by column, magenta layer first, shape (2M,), or of the pairs,
        shape (M,)
    nodes: values of the body's nodes, by column, shape (N,)
    truth: per-pixel labels that the recipe names, by name; see `GroundTruth`
    """

    image: Image
    values: dict[str, float | int | str]
    markers: dict[str, NDArray[Any]]
    nodes: dict[str, NDArray[Any]]
    truth: dict[str, NDArray[Any]]


def common_values(
    sample: Sample, grip: float, load: float, slips: Flags
) -> dict[str, float | int | str]:
    """Values of a frame by column of `COMMON`.

    Parameters
    ----------
    sample: sample of the frame
    grip, load: grip and load that the drive exerts on the object [N]
    slips: whether each node is in contact and slips, shape (N,)
    """
    truth = sample.contact
    field, contact = truth.field, truth.field.contact
    share = float(slips.sum() / contact.sum()) if contact.any() else 0.0
    moved = truth.slip.lateral_displacement
    state = "incipient" if share > 0.0 else "stick"
    state = "gross" if moved > GROSS_SLIP else state if contact.any() else "none"
    values = (
        sample.index,
        sample.time,
        grip,
        load,
        field.total_normal,
        field.total_friction,
        truth.friction,
        field.safety_margin(truth.friction),
        state,
        share,
        1e3 * moved,
        1e3 * truth.place[0],
        1e3 * truth.indentation,
        int(contact.sum()),
    )
    return dict(zip(COMMON, values, strict=True))


def marker_labels(truth: MarkerTruth, unloaded: MarkerTruth) -> dict[str, NDArray[Any]]:
    """Labels of the markers by column of `MARKERS`."""
    moved = truth.centres - unloaded.centres
    columns = [
        *np.moveaxis(truth.image_centres, -1, 0),
        *np.moveaxis(truth.pixels, -1, 0),
        truth.visible,
        truth.overlap,
        *np.moveaxis(1e3 * truth.centres, -1, 0),
        *np.moveaxis(1e3 * moved, -1, 0),
    ]
    return {name: column.ravel() for name, column in zip(MARKERS, columns, strict=True)}
