"""What the node model hands on: the deformation, and the state that a step starts from."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .fingertip import Fingertip

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Deformation:
    """Displacements of the chain and the poses of what it touches.

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
    """State of the plant at one instant.

    Attributes
    ----------
    time: [s]
    deformation: where everything is
    friction: Dahl force of each node, on the node, along the object's tangent [N], shape (N,)
    slip_rate: tangential speed of the object relative to each node [m/s], shape (N,)
    """

    time: float
    deformation: Deformation
    friction: Array
    slip_rate: Array


def rest_state(fingertip: Fingertip) -> State:
    """Undeformed fingertip whose apex just touches the object."""
    n = fingertip.nodes
    deformation = Deformation(nodes=np.zeros((n, 2)), rigid_part=0.0, object_position=0.0)
    return State(time=0.0, deformation=deformation, friction=np.zeros(n), slip_rate=np.zeros(n))
