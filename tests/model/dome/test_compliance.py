"""Compliance of the dome's skin against analysis, symmetry and finer elements."""

import math

import numpy as np
import pytest

from chromagrip.model import Dome, Pad, SoftBody
from chromagrip.model.dome.compliance import (
    WIDTH,
    compliance_scale,
    compliance_table,
    skin_compliance,
)
from chromagrip.model.dome.dome import lattice
from chromagrip.model.dome.layer import layer_motion, layer_moved
from chromagrip.model.kernels.dome.compliance_kernels import fill_block, node_block

SMALL = Dome(pitch=0.8e-3, reach=math.radians(50.0))
PAD = Pad(radius=6e-3, pitch=0.6e-3)


def _block(body: SoftBody, nodes: np.ndarray) -> np.ndarray:
    out = np.zeros((3 * len(nodes), 3 * len(nodes)), np.float32)
    fill_block(skin_compliance(body), nodes, 0, out)
    return out.astype(float)


@pytest.mark.parametrize("body", [SMALL, PAD], ids=lambda body: body.kind)
def test_forces_do_work_on_every_displacement(body: SoftBody) -> None:
    """The compliance is symmetric, and no forces get energy out of the skin."""
    whole = _block(body, np.arange(len(lattice(body).ring)))
    assert np.array_equal(whole, whole.T)
    assert np.linalg.eigvalsh(whole)[0] > 0.0


def test_the_table_of_a_pad_depends_on_the_way_between_nodes_alone() -> None:
    points = lattice(PAD)
    nodes = np.random.default_rng(0).permutation(len(points.ring))[:40]
    found = _block(PAD, nodes).reshape(40, 3, 40, 3).transpose(0, 2, 1, 3)
    motion = layer_motion(
        PAD.thickness, PAD.poisson, math.sqrt(2.0) * WIDTH * PAD.spacing, 0.1, 0.0
    )  # fmt: skip
    places = points.points[nodes, :2]
    direct = layer_moved(motion, places[:, None] - places) / PAD.young
    assert found == pytest.approx(direct, abs=1e-4 * abs(direct).max())


@pytest.mark.parametrize("poisson", [0.3, 0.48])
def test_a_thick_dome_is_a_half_space_between_its_nodes_and_its_size(poisson: float) -> None:
    """u_z = (1 − ν²)·F/(π·E·r) of Boussinesq, but for a constant that the dome's size makes."""
    dome = Dome(core=0.5e-3, poisson=poisson, pitch=0.3e-3, reach=math.radians(20.0))
    points = lattice(dome)
    table, scale, block = compliance_table(dome), compliance_scale(dome), np.empty((3, 3))
    found, expected = 0.0, 0.0
    for ring, sign in ((3, 1.0), (6, -1.0)):
        node_block(table, len(points.angles), 0, 0.0, ring, 0.0, block)
        distance = dome.radius * (points.angles[ring] - points.angles[0])
        found += sign * scale * block[2, 2]
        expected += sign * (1.0 - poisson**2) / (math.pi * dome.young * distance)
    assert found == pytest.approx(expected, rel=0.05)


def test_areas_are_those_of_the_sphere() -> None:
    points = lattice(SMALL)
    top = points.angles[-1] + 0.5 * SMALL.spacing / SMALL.radius
    assert points.areas.sum() == pytest.approx(2 * math.pi * SMALL.radius**2 * (1 - math.cos(top)))
