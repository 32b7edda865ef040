"""Physics of the labels of the node model: sums, friction cones, the margin, balance of forces."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.chain import chain, contact
from ...model.kernels import contact_frames
from ...scene.scene import Scene
from .columns import columns_of
from .sums import wrong_sums

#: Tolerance of the balance of forces, as a share of the largest grip or load.
_BALANCE = 0.05
#: Tolerance of friction cones, as a share of the largest force, and at least [N].
_SHARE, _LEAST = 1e-4, 1e-5


def wrong_chain(row: dict[str, Any], own: dict[str, NDArray[Any]]) -> Iterator[str]:
    """Yield what is wrong with a frame of the node model."""
    normal, friction, mu = (
        own[f"node_{name}"].astype(float) for name in ("normal_n", "friction_n", "mu")
    )
    slack = max(_SHARE * float(abs(normal).max(initial=0.0)), _LEAST)
    if (normal < 0.0).any():
        yield "a node's normal force is negative"
    if (abs(friction) > mu * normal + slack).any():
        yield "friction on a node is more than µ times its normal force"
    touching = own["node_contact"].astype(bool)
    sums = normal[touching].sum(), abs(friction[touching].sum())
    yield from wrong_sums(row, touching, *sums, slack * max(len(normal), 1) ** 0.5)


def unbalanced_chain(
    scene: Scene, frames: dict[str, list[Any]], columns: dict[str, NDArray[Any]]
) -> Iterator[str]:
    """Yield frames in which forces on the fingertip or the object do not balance.

    Grip, load, contact and dampers to ground act on them; there is no inertia. The force of a
    damper follows from the motion between two frames, so that impulses over each interval are
    compared. The object's shape turns contact forces into x and z; of a surface that stays the
    object feels friction alone.
    """
    if scene.frames < 3:
        return
    tip = scene.build_fingertip()
    ch, rest = chain(tip), tip.rest_positions()
    at, on = np.empty((2, scene.frames, 2))
    column = {name: columns[name].astype(float) for name in columns_of("chain").nodes}
    rigid, moved = 1e-3 * np.array(frames["rigid_part_mm"]), 1e-3 * np.array(frames["object_mm"])
    for k, time in enumerate(frames["time_s"]):
        obj = scene.build_object(time)
        seen = 1e-3 * np.column_stack([column["node_x_mm"][k], column["node_z_mm"][k]])
        ground = seen + np.array([0.0, rigid[k]])
        ct = contact(tip, obj)
        _, normal = contact_frames(ct, ground, moved[k])
        tangent = np.column_stack([-normal[:, 1], normal[:, 0]])
        pressed = column["node_normal_n"][k] @ normal
        rubbed = column["node_friction_n"][k] @ tangent
        on[k, 0] = frames["load_n"][k] - ct.travel * pressed[0] - rubbed[0]
        on[k, 1] = frames["grip_n"][k] + pressed[1] + rubbed[1]
        # The outer nodes are held by the rigid part.
        inner = ch.damping[1:-1] @ (ground - rest)[1:-1, 1]
        at[k] = obj.drag * moved[k], inner + ch.damping_rigid * rigid[k]
    off = abs(np.diff(at, axis=0) / scene.period - (on[1:] + on[:-1]) / 2)
    # The mean of both ends is off by a twelfth of the second difference.
    bend = np.pad(abs(np.diff(on, 2, axis=0)), ((1, 1), (0, 0)), mode="edge")
    off -= np.maximum(bend[1:], bend[:-1]) / 12.0
    off -= _BALANCE * max(*frames["grip_n"], *np.abs(frames["load_n"]))
    # The first interval is left out: the fingertip touches down somewhere within it.
    for k, axis in np.argwhere(off[1:] > 0.0):
        yield f"frame {k + 2}: forces along {'xz'[axis]} do not balance since the frame before"
