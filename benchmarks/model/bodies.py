"""Figures of both bodies: one chain solved by two engines, and a chain beside a dome."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.model.chain_on_newton import grasp_by_newton, unstable_modes
from benchmarks.model.side_by_side import side_by_side, side_rows
from chromagrip.model import ContactObject, Fingertip, contact_forces, equilibrium
from chromagrip.output.report import Row, at_most, reported

#: Largest relative difference between the engines: three digits.
THREE_DIGITS = 1e-3


class Grasp(NamedTuple):
    """A grasp that both engines solve: nodes, object, grip and load [N]."""

    name: str
    nodes: int
    obj: ContactObject
    grip: float
    load: float


def _object(stiffness: float, radius: float = 0.0) -> ContactObject:
    return ContactObject(stiffness=stiffness, curvature=1.0 / radius if radius else 0.0)


#: Grasps under which the springs of these chains do not buckle.
GRASPS = (
    Grasp("flat_soft", 101, _object(160.0), 1.0, 0.25),
    Grasp("flat_hard", 101, _object(1000.0), 2.5, 0.65),
    Grasp("round_20mm", 101, _object(160.0, 20e-3), 1.0, 0.25),
    Grasp("round_5mm", 101, _object(1000.0, 5e-3), 2.5, 0.65),
    Grasp("flat_soft_251_nodes", 251, _object(160.0), 1.0, 0.25),
    Grasp("round_5mm_251_nodes", 251, _object(1000.0, 5e-3), 1.0, 0.25),
)
#: Under a hard object the springs of a fine chain buckle: only contact and friction hold them. A
#: solver that takes springs and contact in turns does not come to rest, so it is not compared.
BUCKLED = Grasp("flat_hard_251_nodes", 251, _object(1000.0), 2.5, 0.65)


class Difference(NamedTuple):
    """Of two engines, relative.

    Attributes
    ----------
    normal, friction: of ΣFn and ΣFf
    nodal: largest of a node's force, over the largest force of a node
    nodal_friction: of the nodes' friction, root of the summed squares
    """

    normal: float
    friction: float
    nodal: float
    nodal_friction: float


def compare(grasp: Grasp, parts: int) -> Difference:
    """Difference between `equilibrium` and the dome's solver with the chain's compliance.

    Parameters
    ----------
    parts: in which each raises the grip, and then the load
    """
    tip = Fingertip(nodes=grasp.nodes)
    state = equilibrium(tip, grasp.obj, grasp.grip, grasp.load, parts=parts)
    field = contact_forces(tip, grasp.obj, state)
    other = grasp_by_newton(tip, grasp.obj, grasp.grip, grasp.load, parts)
    normal = np.where(field.contact, other.normal_forces, 0.0)
    friction = np.where(field.contact, other.tangential_forces, 0.0)
    true_normal = np.where(field.contact, field.normal, 0.0)
    true_friction = np.where(field.contact, field.friction, 0.0)
    apart = np.hypot(normal - true_normal, friction - true_friction)
    return Difference(
        normal=abs(normal.sum() / field.total_normal - 1.0),
        friction=abs(abs(friction.sum()) / field.total_friction - 1.0),
        nodal=float(apart.max() / np.hypot(true_normal, true_friction).max()),
        nodal_friction=float(
            np.linalg.norm(friction - true_friction) / np.linalg.norm(true_friction)
        ),
    )


def bench_bodies(quick: bool) -> Iterator[Row]:
    """Rows of both bodies."""
    yield from engine_rows(quick)
    yield from side_rows(side_by_side(quick))


def engine_rows(quick: bool) -> Iterator[Row]:
    """Rows of one chain by two engines; a quick run leaves out the finest chains."""
    parts = 400  # each solver is of first order in them
    for grasp in GRASPS[:4] if quick else GRASPS:
        found = compare(grasp, parts)
        for score in ("normal", "friction", "nodal"):
            name = ("bodies", "engines", grasp.name, score)
            yield at_most(name, getattr(found, score), "", THREE_DIGITS)
        name = ("bodies", "engines", grasp.name, "nodal_friction")
        yield reported(name, found.nodal_friction, "")
    tip = Fingertip(nodes=BUCKLED.nodes)
    state = equilibrium(tip, BUCKLED.obj, BUCKLED.grip)
    modes = unstable_modes(tip, state.deformation.seen)
    yield reported(("bodies", "engines", BUCKLED.name, "unstable_modes"), modes, "")
