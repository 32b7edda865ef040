"""The ranges that a training spans, as the table that a read-out's file holds.

Rows have a name and words for it, a unit, what the training covers from and to, and a note where
the values are not spread evenly between the two. They follow from `RANGES` and `VARIATIONS` field
by field.
"""

from collections.abc import Iterator
from dataclasses import fields
from typing import Any, TypedDict

from ..tracking.forces import TRAINING
from .networks import CODES, NOISE, ODD_CODES, VARIED_CODES
from .ranges import RANGES, SHAPES
from .variations import VariationRanges

#: Unit by the end of a field's name, the longest end first.
_UNITS = {
    "_n_s_per_m": "N·s/m",
    "_mm_per_s": "mm/s",
    "_n_per_m": "N/m",
    "_per_m": "1/m",
    "_levels": "levels",
    "_share": "share",
    "_deg": "°",
    "_mm": "mm",
    "_px": "px",
    "_n": "N",
}
#: Fields that say how often something varies, not how far.
_HOW_OFTEN = ("nominal_share", "each_share")


#: What fields are of, where their names do not say it all.
_WORDS = {
    "friction": "µ",
    "usual_friction": "µ of most objects",
    "stiffness_n_per_m": "k_c per node",
    "usual_stiffness_n_per_m": "k_c per node of most objects",
    "curvature_per_m": "1/radius of hollow (below 0) and round objects",
    "tilt_deg": "slope of tilted surfaces",
    "height_mm": "height of bumps and grooves",
    "width_mm": "width of bumps and grooves, one standard deviation",
    "contacts_apart_mm": "distance of two contacts",
    "ridges_mm": "height of two contacts",
    "bump_curvature_per_m": "curvature of bumps and of two contacts",
    "dahl_stiffness_n_per_m": "σ0 per node",
    "coulomb_stiffness_n_per_m": "σ0 per node of objects without a Dahl law",
    "dahl_exponent": "Dahl exponent n",
    "drag_n_s_per_m": "drag on the object",
    "usual_grip_n": "grip of most histories",
    "slides_by_n": "load above the friction limit",
    "slides_at_mm_per_s": "speed of an object that slides",
    "grip_step": "factor of a step of the grip",
    "tremble": "trembling of the grip over its mean, one standard deviation",
    "membrane": "stiffness of membrane over tissue, over nominal",
    "coupling": "Poisson factors, over nominal",
    "damping": "dampers of the nodes, over nominal",
    "azimuth_noise_deg": "azimuth of the load, in all snapshots",
    "azimuth_deg": "azimuth of the load, further error",
    "azimuth_by_twist": "azimuth of the load, error with a twist, over the twist",
    "off_plane_share": "change of the motion off the chain's plane",
    "contraction": "lateral contraction over shear",
    "twist_deg": "twist about the grip's axis",
    "twist_reach_deg": "angle from the apex at which a twist begins to fall off",
    "twist_decay": "power of the distance with which it falls off",
    "follow_share": "change of a layer's `follow`",
    "depth_share": "change of a layer's depth",
    "unknown_share": "motion that no map describes, over the skin's",
    "size_share": "change of log sizes by blur and light",
}


class RangeRow(TypedDict):
    """One range: from and to in the unit, and how the values lie between them."""

    name: str
    what: str
    unit: str
    low: float
    high: float
    note: str


def training_ranges(
    variations: VariationRanges, noise: float, histories: int, epochs: int
) -> dict[str, object]:
    """Ranges of a training, for the read-out's file.

    Parameters
    ----------
    variations: ranges of variations of specimen and picture
    noise: standard deviation of a pixel [grey levels]
    histories: number of histories of the training
    epochs: number of passes over them
    """
    noise_levels = (NOISE[0] * noise, NOISE[1] * noise)
    return {
        "training": {
            "version": TRAINING,
            "histories": histories,
            "epochs": epochs,
            "noise_levels": noise,
            "codes": [CODES, VARIED_CODES, ODD_CODES],
            "shapes": SHAPES,
            **{name: getattr(variations, name) for name in _HOW_OFTEN},
        },
        "contact and fingertip": list(_rows(RANGES)),
        "specimen and picture": [*_rows(variations), _row("noise_levels", noise_levels)],
    }


def _rows(ranges: Any) -> Iterator[RangeRow]:
    """A row for each field of a dataclass of ranges."""
    for field in fields(ranges):
        if field.name not in _HOW_OFTEN:
            yield _row(field.name, getattr(ranges, field.name))


def _row(field: str, value: float | tuple[float, float]) -> RangeRow:
    end = next((end for end in _UNITS if field.endswith(end)), "")
    note, what = "", _WORDS.get(field, field.removesuffix(end).replace("_", " "))
    # Fields of standard deviations: the table goes to twice as much.
    deviations = ("azimuth_noise_deg", "azimuth_deg", "azimuth_by_twist", "twist_deg")
    # Fields of largest changes to either side.
    either_side = ("off_plane_share", "contraction", "follow_share", "depth_share")
    single = ("coulomb_stiffness_n_per_m",)  # fields that are one value in a few cases
    if isinstance(value, tuple):
        low, high = value
    elif field in deviations:
        low, high, note = -2.0 * value, 2.0 * value, "normal, two standard deviations"
    elif field in either_side:
        low, high = -value, value
    elif field in single:
        low, high, note = value, value, "a few"
    else:
        low, high = 0.0, value
    unit = _UNITS.get(end, "")
    return RangeRow(name=field, what=what, unit=unit, low=low, high=high, note=note)


def range_lines(ranges: dict[str, Any]) -> list[tuple[str, str, str, str, str]]:
    """Words, unit, from, to and note of every range of a read-out's file, as texts."""
    return [
        (row["what"], row["unit"], f"{row['low']:.4g}", f"{row['high']:.4g}", row["note"])
        for rows in ranges.values()
        if isinstance(rows, list)
        for row in rows
    ]
