"""State of the node model: the deformation, and everything else that a step starts from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .fingertip import Fingertip

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Deformation:
    """Displacements of the chain, and poses of rigid part and object.

    Attributes
    ----------
    nodes: node displacements (x, z) from rest, in the ground frame [m], shape (N, 2)
    rigid_part: displacement of the rigid part along z [m]
    object_position: displacement of the object along x [m]
    """

    nodes: Array
    rigid_part: float
    object_position: float

    @property
    def seen(self) -> Array:
        """Node displacements relative to the rigid part, on which the camera sits [m], (N, 2)."""
        return self.nodes - np.array([0.0, self.rigid_part])


@dataclass(frozen=True, kw_only=True)
class State:
    """State of fingertip and object at one instant.

    Attributes
    ----------
    time: time of the state [s]
    deformation: displacements of nodes, rigid part and object
    friction: Dahl force on each node, along the object's tangent [N], shape (N,)
    slip_rate: tangential speed of the object relative to each node near contact [m/s], shape (N,)
    rate: mean rates of the nodes (x, z) and, last, of (rigid part, object) over the previous step
        [m/s], shape (N + 1, 2)
    step: length of the previous step [s]; 0 if there was none
    """

    time: float
    deformation: Deformation
    friction: Array
    slip_rate: Array
    rate: Array
    step: float

    @property
    def carried(self) -> Array:
        """Input of the membrane map: displacements of the nodes from the rigid part [m], (N, 2)."""
        return self.deformation.seen


def state_of(
    time: float,
    nodes: Array,
    pose: Array,
    friction: Array,
    slip_rate: Array,
    rate: Array,
    step: float,
) -> State:
    """Make a state from copies of the kernels' arrays; `pose` is (rigid part, object) [m]."""
    return State(
        time=float(time),
        deformation=Deformation(
            nodes=nodes.copy(), rigid_part=float(pose[0]), object_position=float(pose[1])
        ),
        friction=friction.copy(),
        slip_rate=slip_rate.copy(),
        rate=rate.copy(),
        step=float(step),
    )


def rest_state(fingertip: Fingertip) -> State:
    """State of an undeformed fingertip whose apex just touches the object."""
    n = fingertip.nodes
    deformation = Deformation(nodes=np.zeros((n, 2)), rigid_part=0.0, object_position=0.0)
    return State(
        time=0.0,
        deformation=deformation,
        friction=np.zeros(n),
        slip_rate=np.zeros(n),
        rate=np.zeros((n + 1, 2)),
        step=0.0,
    )
