"""Columns of a dataset's tables and their meanings."""

from typing import NamedTuple

from ...output.parquet import FORCES
from ...scene.scene import Body


class Columns(NamedTuple):
    """Columns by name, in order, with their meanings.

    Attributes
    ----------
    frame: of `frames.parquet`, a value for each frame
    markers: of `markers.parquet`, lists of 2M, layer 0 (magenta) before 1 (yellow), or of M
    nodes: of `markers.parquet` too, lists of the N nodes of the body
    """

    frame: dict[str, str]
    markers: dict[str, str]
    nodes: dict[str, str]


#: Values of the column `slip_state`.
STATES = ("none", "stick", "incipient", "gross")
#: Labels of every pixel that only a dome has.
DOME_TRUTH = ("traction", "contact")

#: Columns of a frame of any body.
COMMON = {
    "frame": "number in the sequence",
    "time_s": "instant",
    "grip_n": "force of the gripper's drive",
    "load_n": "lateral load on the object",
    "normal_n": "ΣFn",
    "friction_n": "ΣFf",
    "mu": "µ of the contact",
    "margin": "Γ; NaN without contact",
    "slip_state": "none (no contact), stick, incipient or gross: slip of more than 0.2 mm so far",
    "slipped_share": "share of the nodes in contact that carry 98 % of what friction holds",
    "lateral_displacement_mm": "of the object over the fingertip, largest so far",
    "object_mm": "position of the object along x",
    "rigid_part_mm": "indentation",
    "contact_nodes": "nodes in contact",
}
_DOME_FRAME = COMMON | {
    "rigid_part_mm": "way of the object towards the dome since the first touch",
    "object_mm": "way of the object along x since the first touch",
    "limit_margin": "margin against the limit surface of force and torsion; NaN without contact",
    "force_x_n": "force of the object on the dome",
    "force_y_n": "the same",
    "force_z_n": "the same; a press is negative",
    "torque_x_nmm": "its torque on the dome, about the middle of the sphere",
    "torque_y_nmm": "the same",
    "torque_z_nmm": "the same",
    "object_x_mm": "place of the object's own origin in the sensor frame",
    "object_y_mm": "the same",
    "object_z_mm": "the same",
    "object_turn_x_rad": "rotation vector from the object's own axes to the sensor's",
    "object_turn_y_rad": "the same",
    "object_turn_z_rad": "the same",
}
#: Columns of the markers of a frame of any body.
MARKERS = {
    "x_px": "centroid of the marker's outline in the image, to the right (2M)",
    "y_px": "the same, down (2M)",
    "projected_x_px": "where the marker's centre is projected to, to the right (2M)",
    "projected_y_px": "the same, down (2M)",
    "visible": "marker is there, faces the camera and lies in the image (2M)",
    "overlap": "share of the magenta marker that yellow covers (M)",
    "centre_x_mm": "centre in the sensor frame (2M)",
    "centre_y_mm": "the same (2M)",
    "centre_z_mm": "the same (2M)",
    "moved_x_mm": "motion of the centre since rest (2M)",
    "moved_y_mm": "the same (2M)",
    "moved_z_mm": "the same (2M)",
}
_CHAIN_MARKERS = MARKERS | {
    "normal_n": "normal force at the marker's place, of a node's pitch of the chain (2M)",
    "friction_n": "friction there (2M)",
}
_CHAIN_NODES = {
    "node_x_mm": "place of each node in the sensor frame (N)",
    "node_z_mm": "the same (N)",
    "node_contact": "node counts as in contact: of these forces are the sums (N)",
    "node_normal_n": "normal force on each node (N)",
    "node_friction_n": "friction on each node, along the object's tangent (N)",
    "node_mu": "µ of the object at each node (N)",
}
_DOME_NODES = {
    "node_x_mm": "place of each node of the pressed skin in the sensor frame (N)",
    "node_y_mm": "the same (N)",
    "node_z_mm": "the same (N)",
    "node_contact": "node counts as in contact (N)",
    "node_slips": "node in contact carries 98 % of what friction holds (N)",
    "node_normal_n": "normal force of the object on each node (N)",
    "node_direction_x": "unit vector of the normal force, from the object; 0 out of contact (N)",
    "node_direction_y": "the same (N)",
    "node_direction_z": "the same (N)",
    "node_friction_x_n": "friction on each node, across its direction (N)",
    "node_friction_y_n": "the same (N)",
    "node_friction_z_n": "the same (N)",
    "node_area_mm2": "area of the skin that each node stands for: traction is force over it (N)",
}
_OF = {
    "chain": Columns(COMMON, _CHAIN_MARKERS, _CHAIN_NODES),
    "dome": Columns(_DOME_FRAME, MARKERS, _DOME_NODES),
}


#: Columns of estimates that no reading has: the frame's own, and lists of nodes.
_NOT_READ = ("frame", "time_s", "markers_seen", "node_normal_n", "node_friction_n")
#: Start of the name of every column of a reading; what follows is the label's name.
READ = "reading_"
#: Columns of a reading, which are estimates and no labels, with those of `FORCES` that they are of.
READING = {
    READ + name.replace("torque", "torque_z"): name for name in FORCES if name not in _NOT_READ
}

#: Labels that a reading estimates, by the start of their names, and their units.
_ESTIMATED = {
    "normal": "_n", "friction": "_n", "mu": "", "margin": "", "limit_margin": "",
    "force_x": "_n", "force_y": "_n", "force_z": "_n", "torque_z": "_nmm",
}  # fmt: skip
#: Columns of an estimate's lower end, value and upper end, by the label that it is of.
INTERVALS = {
    stem + unit: (f"{READ}{stem}_low{unit}", f"{READ}{stem}{unit}", f"{READ}{stem}_high{unit}")
    for stem, unit in _ESTIMATED.items()
}


def columns_of(body: Body, reading: bool = False) -> Columns:
    """Columns of the tables of a sequence with that body, and with or without a reading."""
    columns = _OF[body]
    if not reading:
        return columns
    read = {name: f"read from the picture: {FORCES[of][1]}" for name, of in READING.items()}
    return columns._replace(frame=columns.frame | read)
