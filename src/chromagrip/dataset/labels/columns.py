"""Columns of a dataset: meaning, unit, and the range of values that is possible."""

import math
from typing import NamedTuple

from ...output.parquet import FORCES
from ...scene.scene import Body


class Column(NamedTuple):
    """A column of `frames.parquet` or `markers.parquet`.

    Attributes
    ----------
    meaning: meaning of the values
    unit: unit of the values; empty for a pure number, a word or a flag
    low, high: smallest and largest value that is possible; not used for words and flags
    missing: condition under which a value may be NaN; empty: never
    """

    meaning: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    missing: str = ""


class Columns(NamedTuple):
    """Columns by name, in order.

    Attributes
    ----------
    frame: columns of `frames.parquet`, a value for each frame
    markers: columns of `markers.parquet` with a list of all 2M markers, magenta layer first, or of
        the M pairs
    nodes: columns of `markers.parquet` with a list of the N nodes of the body
    """

    frame: dict[str, Column]
    markers: dict[str, Column]
    nodes: dict[str, Column]


#: Values of the column `slip_state`.
STATES = ("none", "stick", "incipient", "gross")
#: Names of the labels of every pixel that only a dome has.
DOME_TRUTH = ("traction", "contact")

_NO_CONTACT, _NO_MARKER = "without contact", "where the marker is missing"
_NO_ESTIMATE = "where the reading has no estimate of it"
_SAME = "the same"

#: Columns of a frame, for any body. Where friction is found by iteration, Γ of gross slip may be a
#: little below 0.
COMMON = {
    "frame": Column("number in the sequence", low=0),
    "time_s": Column("instant", "s", 0.0),
    "grip_n": Column("force of the gripper's drive", "N"),
    "load_n": Column("lateral load on the object", "N"),
    "normal_n": Column("ΣFn", "N", 0.0),
    "friction_n": Column("ΣFf", "N"),
    "mu": Column("µ of the contact", low=0.0, missing=_NO_CONTACT),
    "margin": Column("Γ; NaN without contact", "", -1e-3, 1.0, _NO_CONTACT),
    "slip_state": Column(
        "none (no contact), stick, incipient or gross: slip of more than 0.2 mm so far"
    ),
    "slipped_share": Column(
        "share of the nodes in contact that carry 98 % of what friction holds", "", 0.0, 1.0
    ),
    "lateral_displacement_mm": Column(
        "of the object over the fingertip, largest so far", "mm", 0.0
    ),
    "object_mm": Column("position of the object along x", "mm"),
    "rigid_part_mm": Column("indentation", "mm"),
    "contact_nodes": Column("nodes in contact", low=0),
}
_TORQUE = "torque of the object on the dome, about the axis through the sphere's centre along"
_TURN = Column(_SAME, "rad", -math.pi, math.pi)
_DOME_FRAME = COMMON | {
    "rigid_part_mm": Column("way of the object towards the dome since the first touch", "mm"),
    "object_mm": Column("way of the object along x since the first touch", "mm"),
    "limit_margin": Column(
        "margin against the limit surface of force and torsion; NaN without contact",
        high=1.0, missing=_NO_CONTACT,
    ),
    "force_x_n": Column("force of the object on the dome along x", "N"),
    "force_y_n": Column("force of the object on the dome along y", "N"),
    "force_z_n": Column("the same along z; a press is negative", "N"),
    "torque_x_nmm": Column(f"{_TORQUE} x", "N·mm"),
    "torque_y_nmm": Column(f"{_TORQUE} y", "N·mm"),
    "torque_z_nmm": Column(f"{_TORQUE} z", "N·mm"),
    "object_x_mm": Column("place of the object's own origin in the sensor frame", "mm"),
    "object_y_mm": Column(_SAME, "mm"),
    "object_z_mm": Column(_SAME, "mm"),
    "object_turn_x_rad": _TURN._replace(
        meaning="rotation vector from the object's own axes to the sensor's"
    ),
    "object_turn_y_rad": _TURN,
    "object_turn_z_rad": _TURN,
}  # fmt: skip
#: Columns of the markers of a frame, for any body.
MARKERS = {
    "x_px": Column(
        "centroid of the marker's outline in the image, to the right (2M)",
        "px", missing=_NO_MARKER,
    ),
    "y_px": Column("the same, down (2M)", "px", missing=_NO_MARKER),
    "projected_x_px": Column(
        "where the marker's centre is projected to, to the right (2M)", "px", missing=_NO_MARKER
    ),
    "projected_y_px": Column("the same, down (2M)", "px", missing=_NO_MARKER),
    "visible": Column("marker is there, faces the camera and lies in the image (2M)"),
    "overlap": Column(
        "share of the magenta marker that yellow covers (M)", "", 0.0, 1.0, _NO_MARKER
    ),
    "centre_x_mm": Column("centre in the sensor frame (2M)", "mm", missing=_NO_MARKER),
    "centre_y_mm": Column("the same (2M)", "mm", missing=_NO_MARKER),
    "centre_z_mm": Column("the same (2M)", "mm", missing=_NO_MARKER),
    "moved_x_mm": Column("motion of the centre since rest (2M)", "mm", missing=_NO_MARKER),
    "moved_y_mm": Column("the same (2M)", "mm", missing=_NO_MARKER),
    "moved_z_mm": Column("the same (2M)", "mm", missing=_NO_MARKER),
}  # fmt: skip
_CHAIN_MARKERS = MARKERS | {
    "normal_n": Column(
        "normal force at the marker's place, of a node's pitch of the chain (2M)", "N", 0.0
    ),
    "friction_n": Column("friction there (2M)", "N"),
}
_CHAIN_NODES = {
    "node_x_mm": Column("place of each node in the sensor frame (N)", "mm"),
    "node_z_mm": Column("the same (N)", "mm"),
    "node_contact": Column("node counts as in contact: of these forces are the sums (N)"),
    "node_normal_n": Column("normal force on each node (N)", "N", 0.0),
    "node_friction_n": Column("friction on each node, along the object's tangent (N)", "N"),
    "node_mu": Column("µ of the object at each node (N)", low=0.0),
}
_UNIT = Column("the same (N)", "", -1.0, 1.0)
_DOME_NODES = {
    "node_x_mm": Column("place of each node of the pressed skin in the sensor frame (N)", "mm"),
    "node_y_mm": Column("the same (N)", "mm"),
    "node_z_mm": Column("the same (N)", "mm"),
    "node_contact": Column("node counts as in contact (N)"),
    "node_slips": Column("node in contact carries 98 % of what friction holds (N)"),
    "node_normal_n": Column("normal force of the object on each node (N)", "N", 0.0),
    "node_direction_x": _UNIT._replace(
        meaning="unit vector of the normal force, from the object; 0 out of contact (N)"
    ),
    "node_direction_y": _UNIT,
    "node_direction_z": _UNIT,
    "node_friction_x_n": Column("friction on each node, across its direction (N)", "N"),
    "node_friction_y_n": Column("the same (N)", "N"),
    "node_friction_z_n": Column("the same (N)", "N"),
    "node_area_mm2": Column(
        "area of the skin that each node stands for: traction is force over it (N)", "mm²", 0.0
    ),
}
_OF = {
    "chain": Columns(COMMON, _CHAIN_MARKERS, _CHAIN_NODES),
    "dome": Columns(_DOME_FRAME, MARKERS, _DOME_NODES),
}


# A reading is a reconstructor's estimate from the pictures, stored next to the labels.
#: Columns of `FORCES` that are not stored in a reading: the frame's own, and lists of nodes.
_NOT_READ = ("frame", "time_s", "markers_seen", "node_normal_n", "node_friction_n")
#: Prefix of the name of every column of a reading; the label's name follows.
READ = "reading_"
#: Column of `FORCES` for each column of a reading.
READING = {
    READ + name.replace("torque", "torque_z"): name for name in FORCES if name not in _NOT_READ
}

#: Unit suffix of each label that a reading estimates, by the stem of its name.
_ESTIMATED = {
    "normal": "_n", "friction": "_n", "mu": "", "margin": "", "limit_margin": "",
    "force_x": "_n", "force_y": "_n", "force_z": "_n", "torque_z": "_nmm",
}  # fmt: skip
#: Columns of an estimate's lower bound, value and upper bound, by the estimated label.
INTERVALS = {
    stem + unit: (f"{READ}{stem}_low{unit}", f"{READ}{stem}{unit}", f"{READ}{stem}_high{unit}")
    for stem, unit in _ESTIMATED.items()
}


def columns_of(body: Body, reading: bool = False) -> Columns:
    """Columns of a body's tables; with `reading`, also those of a reconstructor's estimates."""
    columns = _OF[body]
    if not reading:
        return columns
    read = {name: _read(name, *FORCES[of]) for name, of in READING.items()}
    return columns._replace(frame=columns.frame | read)


def _read(name: str, kind: str, meaning: str) -> Column:
    """Column of a reading, with the kind and the meaning from `FORCES`."""
    unit = next((unit for end, unit in (("_nmm", "N·mm"), ("_n", "N")) if name.endswith(end)), "")
    missing = _NO_ESTIMATE if kind == "float64" else ""
    meaning = f"read from the picture: {meaning}"
    return Column(meaning, unit, missing=missing)
