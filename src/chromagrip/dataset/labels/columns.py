"""Columns of a dataset: meaning, unit, and the law that `dataset check` compares each with."""

from typing import NamedTuple

from ...output.parquet import FORCES
from ...scene.scene import Body


class Column(NamedTuple):
    """A column of `frames.parquet` or `markers.parquet`.

    Attributes
    ----------
    meaning: meaning of the values
    unit: unit of the values; empty for a pure number, a word or a flag
    law: law by which the values follow from the scene and other columns
    tolerance: largest difference from the law, in `unit`; not used for words and flags
    share: further tolerance, as a share of the largest magnitude in the column
    missing: condition under which a value may be NaN; empty: never
    """

    meaning: str
    unit: str
    law: str
    tolerance: float = 0.0
    share: float = 0.0
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

# Laws name the columns that they use, so that a message names every column that may be wrong.
_GRID = "the frame grid"
_AGAIN = "the scene simulated again"
_SUM = "the sum over node_normal_n and the nodes' friction where node_contact"
_OBJECT = "the object of the scene"
_WAY = "its place at the first touch and {}"
_CAMERA = "the projection of the markers through the camera"
_SKIN = "the skin at node_x_mm …, node_z_mm"
_BALANCE = "the balance of node_normal_n, node_friction_n and the skin's springs"
_CHAIN_DEPTH = "the depth of node_x_mm, node_z_mm, with rigid_part_mm and object_mm, in the object"
_DEPTH = (
    "the depth of node_x_mm, node_y_mm, node_z_mm, on node_area_mm2, in the object at "
    "object_x_mm …, object_turn_x_rad …"
)
_NORMAL = "the object's normal at node_x_mm, node_y_mm, node_z_mm"
_ELASTIC = "the elasticity of the silicone under the nodes that the object presses"
_SHEARED = f"{_ELASTIC} (where it is viscous: {_AGAIN})"
_READ = "the picture, read again"
_NO_CONTACT, _NO_MARKER = "without contact", "where the marker is missing"
_NO_ESTIMATE = "where the reading has no estimate of it"

#: Columns of a frame, for any body.
COMMON = {
    "frame": Column("number in the sequence", "", _GRID),
    "time_s": Column("instant", "s", _GRID, 1e-9),
    "grip_n": Column("force of the gripper's drive", "N", _AGAIN, 1e-6, 2e-6),
    "load_n": Column("lateral load on the object", "N", _AGAIN, 1e-6, 2e-6),
    "normal_n": Column("ΣFn", "N", _SUM, 1e-6, 2e-6),
    "friction_n": Column("ΣFf", "N", _SUM, 1e-6, 2e-6),
    "mu": Column("µ of the contact", "", _OBJECT, 1e-6, missing=_NO_CONTACT),
    "margin": Column(
        "Γ; NaN without contact", "", "normal_n, friction_n and mu", 1e-6, missing=_NO_CONTACT
    ),
    "slip_state": Column(
        "none (no contact), stick, incipient or gross: slip of more than 0.2 mm so far",
        "",
        "lateral_displacement_mm, slipped_share and node_contact",
    ),
    "slipped_share": Column(
        "share of the nodes in contact that carry 98 % of what friction holds",
        "",
        "the nodes' friction over µ·node_normal_n",
        1e-9,
    ),
    "lateral_displacement_mm": Column(
        "of the object over the fingertip, largest so far", "mm", _AGAIN, 1e-6, 0.01
    ),
    "object_mm": Column("position of the object along x", "mm", _AGAIN, 1e-5, 0.01),
    "rigid_part_mm": Column("indentation", "mm", _AGAIN, 1e-5, 0.01),
    "contact_nodes": Column("nodes in contact", "", _SUM),
}
_TORQUE = "torque of the object on the dome, about the axis through the sphere's centre along"
_DOME_FRAME = COMMON | {
    "rigid_part_mm": COMMON["rigid_part_mm"]._replace(
        meaning="way of the object towards the dome since the first touch"
    ),
    "object_mm": COMMON["object_mm"]._replace(
        meaning="way of the object along x since the first touch"
    ),
    "limit_margin": Column(
        "margin against the limit surface of force and torsion; NaN without contact",
        "", "mu and the limit surface of the nodes' forces", 1e-4, missing=_NO_CONTACT,
    ),
    "force_x_n": Column("force of the object on the dome along x", "N", _SUM, 1e-6, 2e-6),
    "force_y_n": Column("force of the object on the dome along y", "N", _SUM, 1e-6, 2e-6),
    "force_z_n": Column("the same along z; a press is negative", "N", _SUM, 1e-6, 2e-6),
    "torque_x_nmm": Column(f"{_TORQUE} x", "N·mm", _SUM, 1e-5, 2e-6),
    "torque_y_nmm": Column(f"{_TORQUE} y", "N·mm", _SUM, 1e-5, 2e-6),
    "torque_z_nmm": Column(f"{_TORQUE} z", "N·mm", _SUM, 1e-5, 2e-6),
    "object_x_mm": Column(
        "place of the object's own origin in the sensor frame",
        "mm", _WAY.format("object_mm"), 1e-5,
    ),
    "object_y_mm": Column("the same", "mm", _AGAIN, 1e-5),
    "object_z_mm": Column("the same", "mm", _WAY.format("rigid_part_mm"), 1e-5),
    "object_turn_x_rad": Column(
        "rotation vector from the object's own axes to the sensor's", "rad", _AGAIN, 1e-6
    ),
    "object_turn_y_rad": Column("the same", "rad", _AGAIN, 1e-6),
    "object_turn_z_rad": Column("the same", "rad", _AGAIN, 1e-6),
}  # fmt: skip
#: Columns of the markers of a frame, for any body.
MARKERS = {
    "x_px": Column(
        "centroid of the marker's outline in the image, to the right (2M)",
        "px", _CAMERA, 0.002, missing=_NO_MARKER,
    ),
    "y_px": Column("the same, down (2M)", "px", _CAMERA, 0.002, missing=_NO_MARKER),
    "projected_x_px": Column(
        "where the marker's centre is projected to, to the right (2M)",
        "px", _CAMERA, 0.002, missing=_NO_MARKER,
    ),
    "projected_y_px": Column("the same, down (2M)", "px", _CAMERA, 0.002, missing=_NO_MARKER),
    "visible": Column(
        "marker is there, faces the camera and lies in the image (2M)", "", _CAMERA
    ),
    "overlap": Column(
        "share of the magenta marker that yellow covers (M)",
        "", "the outlines of both layers", 0.005, missing=_NO_MARKER,
    ),
    "centre_x_mm": Column(
        "centre in the sensor frame (2M)", "mm", _SKIN, 5e-5, missing=_NO_MARKER
    ),
    "centre_y_mm": Column("the same (2M)", "mm", _SKIN, 5e-5, missing=_NO_MARKER),
    "centre_z_mm": Column("the same (2M)", "mm", _SKIN, 5e-5, missing=_NO_MARKER),
    "moved_x_mm": Column(
        "motion of the centre since rest (2M)", "mm", _SKIN, 5e-5, missing=_NO_MARKER
    ),
    "moved_y_mm": Column("the same (2M)", "mm", _SKIN, 5e-5, missing=_NO_MARKER),
    "moved_z_mm": Column("the same (2M)", "mm", _SKIN, 5e-5, missing=_NO_MARKER),
}  # fmt: skip
_CHAIN_MARKERS = MARKERS | {
    "normal_n": Column(
        "normal force at the marker's place, of a node's pitch of the chain (2M)",
        "N", "the nodes beside the marker", 1e-8, 1e-5,
    ),
    "friction_n": Column(
        "friction there (2M)", "N", "the nodes beside the marker", 1e-8, 1e-5
    ),
}  # fmt: skip
_CHAIN_NODES = {
    "node_x_mm": Column("place of each node in the sensor frame (N)", "mm", _BALANCE, 1e-5),
    "node_z_mm": Column("the same (N)", "mm", _BALANCE, 1e-5),
    "node_contact": Column(
        "node counts as in contact: of these forces are the sums (N)", "", _CHAIN_DEPTH
    ),
    "node_normal_n": Column("normal force on each node (N)", "N", _CHAIN_DEPTH, 1e-6, 2e-3),
    "node_friction_n": Column(
        "friction on each node, along the object's tangent (N)",
        "N", "the friction law along the way of object_mm over node_x_mm, node_z_mm", 1e-5, 0.1,
    ),
    "node_mu": Column("µ of the object at each node (N)", "", _OBJECT, 1e-6),
}  # fmt: skip
_DOME_NODES = {
    "node_x_mm": Column(
        "place of each node of the pressed skin in the sensor frame (N)", "mm", _ELASTIC, 5e-5
    ),
    "node_y_mm": Column("the same (N)", "mm", _ELASTIC, 5e-5),
    "node_z_mm": Column("the same (N)", "mm", _ELASTIC, 5e-5),
    "node_contact": Column("node counts as in contact (N)", "", _DEPTH),
    "node_slips": Column(
        "node in contact carries 98 % of what friction holds (N)", "", "the cone of friction"
    ),
    "node_normal_n": Column("normal force of the object on each node (N)", "N", _DEPTH, 1e-6, 5e-3),
    "node_direction_x": Column(
        "unit vector of the normal force, from the object; 0 out of contact (N)",
        "", _NORMAL, 1e-3,
    ),
    "node_direction_y": Column("the same (N)", "", _NORMAL, 1e-3),
    "node_direction_z": Column("the same (N)", "", _NORMAL, 1e-3),
    "node_friction_x_n": Column(
        "friction on each node, across its direction (N)", "N", _SHEARED, 1e-5, 2e-3
    ),
    "node_friction_y_n": Column("the same (N)", "N", _SHEARED, 1e-5, 2e-3),
    "node_friction_z_n": Column("the same (N)", "N", _SHEARED, 1e-5, 2e-3),
    "node_area_mm2": Column(
        "area of the skin that each node stands for: traction is force over it (N)",
        "mm²", "the nodes of the silicone", 1e-6, 1e-6,
    ),
}  # fmt: skip
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
    return Column(meaning, unit, _READ, 1e-4, 0.02, missing)
