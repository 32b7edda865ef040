"""The ranges that a training spans, as the table that a read-out's file holds.

Rows have a name and a unit, what the training covers from and to, and a note where the values are
not spread evenly between the two. They follow from `RANGES` and `VARIATIONS` field by field.
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
#: Fields of standard deviations: the table goes to twice as much.
_DEVIATIONS = ("azimuth_noise_deg", "azimuth_deg", "twist_deg")
#: Fields of largest changes to either side.
_EITHER_SIDE = ("off_plane_share", "contraction", "follow_share", "depth_share")
#: Fields that are one value in a few cases.
_SINGLE = ("coulomb_stiffness_n_per_m",)
#: Fields that say how often something varies, not how far.
_HOW_OFTEN = ("nominal_share", "each_share")


class RangeRow(TypedDict):
    """One range: from and to in the unit, and how the values lie between them."""

    name: str
    unit: str
    low: float
    high: float
    note: str


def spanned_ranges(
    variations: VariationRanges, noise: float, histories: int, epochs: int
) -> dict[str, object]:
    """Ranges of a training, for the read-out's file.

    Parameters
    ----------
    variations: of specimen and picture
    noise: of the camera [grey levels]
    histories: that were learned from
    epochs: passes over them
    """
    levels = RangeRow(
        name="camera noise", unit="levels", low=NOISE[0] * noise, high=NOISE[1] * noise, note=""
    )
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
        "specimen and picture": [*_rows(variations), levels],
    }


def _rows(ranges: Any) -> Iterator[RangeRow]:
    """A row for each field of a dataclass of ranges."""
    for field in fields(ranges):
        if field.name not in _HOW_OFTEN:
            yield _row(field.name, getattr(ranges, field.name))


def _row(field: str, value: float | tuple[float, float]) -> RangeRow:
    end = next((end for end in _UNITS if field.endswith(end)), "")
    name = field.removesuffix(end).replace("_", " ")
    note = ""
    if isinstance(value, tuple):
        low, high = value
    elif field in _DEVIATIONS:
        low, high, note = -2.0 * value, 2.0 * value, "normal, two standard deviations"
    elif field in _EITHER_SIDE:
        low, high = -value, value
    elif field in _SINGLE:
        low, high, note = value, value, "a few"
    else:
        low, high = 0.0, value
    return RangeRow(name=name, unit=_UNITS.get(end, ""), low=low, high=high, note=note)


def range_lines(ranges: dict[str, Any]) -> list[tuple[str, str, str, str, str]]:
    """Name, unit, from, to and note of every range of a read-out's file, as texts."""
    return [
        (row["name"], row["unit"], f"{row['low']:.4g}", f"{row['high']:.4g}", row["note"])
        for rows in ranges.values()
        if isinstance(rows, list)
        for row in rows
    ]
