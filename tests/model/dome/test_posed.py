"""Contacts at prescribed poses are those that a dome is stepped to."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from chromagrip.model import Dome, Solid, press_and_move, simulate_contact
from chromagrip.model.dome import PosedContact, PosedContacts, together
from chromagrip.model.shapes import Shape, ball, distances, plane, quadric

DOME = Dome(pitch=0.7e-3, reach=math.radians(45.0))


def moved(contacts: PosedContacts, solid: Solid, height: float) -> PosedContact:
    """Press by 0.4 mm, then shift by 0.1 mm, from where the object's place touches."""
    upright = np.eye(3)
    contact = contacts.untouched(upright, np.array([0.0, 0.0, height]))
    for k in range(1, 31):
        press, shift = min(k, 20) / 20 * 0.4e-3, max(0, k - 20) / 10 * 0.1e-3
        place = np.array([shift, 0.0, height - press])
        contact = contacts.look(contact, solid, upright, place)
        contact = contacts.step(contact, solid, upright, place)
    return contact


@pytest.mark.parametrize(("shape", "height"), [(plane(), 8e-3), (ball(5e-3), 13e-3)])
def test_a_way_of_poses_is_the_motion_of_a_stepper(shape: Shape, height: float) -> None:
    solid = Solid(shape=shape)
    contact = moved(PosedContacts(DOME), solid, height)
    motion = press_and_move(0.4e-3, shift=(0.1e-3, 0.0), press_s=0.2, move_s=0.1)
    run = simulate_contact(DOME, solid, motion, dt=0.01)
    force = run.total_forces[-1]
    assert abs(force[0]) > 0.05
    assert contact.forces.sum(axis=0) == pytest.approx(force, abs=2e-3 * np.linalg.norm(force))
    assert contact.normal.sum() > 0.0
    # A history can be gone on from twice: a step leaves it as it was.
    contacts, upright = PosedContacts(DOME), np.eye(3)
    there = contact.place + np.array([0.05e-3, 0.0, 0.0])
    before = contact.friction.copy()
    last = contacts.look(contact, solid, upright, there)
    one, two = (contacts.step(last, solid, upright, there) for _ in range(2))
    assert np.array_equal(one.forces, two.forces)
    assert np.array_equal(contact.friction, before)


def test_what_a_change_does_to_a_contact_is_what_a_step_with_it_does() -> None:
    contacts, times = PosedContacts(DOME), 1e4
    place, turn = np.array([0.12e-3, 0.0, 7.45e-3]), 0.02

    def posed(twist: float) -> np.ndarray:
        return Rotation.from_rotvec([0.0, 0.0, twist]).as_matrix()

    def ways(share: float) -> tuple[list[Solid], np.ndarray, np.ndarray]:
        """Objects and poses: unchanged, stiffer, of more friction, shifted, pressed and turned."""
        solids = [
            Solid(shape=quadric(50.0, 60.0), stiffness=k, friction=mu)
            for k, mu in [
                (1e9, 0.5), (1e9 * (1.0 + 0.1 * share), 0.5), (1e9, 0.5 * (1.0 + 0.1 * share)),
                *[(1e9, 0.5)] * 3,
            ]
        ]  # fmt: skip
        places = np.array([place] * 6)
        places[3, 0] += 2e-6 * share
        places[4, 2] -= 2e-6 * share
        rotation = np.array([posed(turn)] * 5 + [posed(turn + 2e-3 * share)])
        return solids, rotation, places

    last = moved(contacts, ways(0.0)[0][0], 8e-3)
    last = contacts.look(last, ways(0.0)[0][0], posed(turn), place)
    after = contacts.step(last, ways(0.0)[0][0], posed(turn), place)
    told = contacts.changed(together([last] * 6), after, *ways(1.0 / times), times)
    for k in range(5):
        ends = []
        for share in (-0.3, 0.3):
            solids, rotation, places = ways(share)
            ends.append(contacts.step(last, solids[k + 1], rotation[k + 1], places[k + 1]))
        for name in ("linear", "forces", "friction", "displacement"):
            wanted = (getattr(ends[1], name) - getattr(ends[0], name)) / 0.6
            change = getattr(told.at(k), name) - getattr(after, name)
            assert change == pytest.approx(wanted, abs=0.03 * abs(wanted).max()), (k, name)


@pytest.mark.parametrize(
    ("bent", "same", "lift"),
    [((0.0, 0.0), plane(), 0.0), ((200.0, 200.0), ball(5e-3), 5e-3)],
)
def test_a_quadric_is_a_plane_and_a_ball(
    bent: tuple[float, float], same: Shape, lift: float
) -> None:
    points = np.random.default_rng(1).uniform(-3e-3, 3e-3, (200, 3)) - [0.0, 0.0, 2e-3]
    gap, normal = distances(quadric(*bent), points)
    wanted, along = distances(same, points - [0.0, 0.0, lift])
    assert gap == pytest.approx(wanted, abs=1e-12)
    assert normal == pytest.approx(along, abs=1e-9)


def test_a_quadric_turns_with_its_curvatures_and_can_be_hollow() -> None:
    points = np.random.default_rng(2).uniform(-1e-3, 1e-3, (50, 3))
    c, s = math.cos(0.7), math.sin(0.7)
    turn = np.array([[c, -s], [s, c]])
    curves = turn @ np.diag([150.0, 40.0]) @ turn.T
    turned = quadric(curves[0, 0], curves[1, 1], curves[0, 1])
    whole = np.eye(3)
    whole[:2, :2] = turn
    gap, _ = distances(quadric(150.0, 40.0), points)
    again, normal = distances(turned, points @ whole.T)
    assert again == pytest.approx(gap, abs=1e-12)
    assert np.linalg.norm(normal, axis=1) == pytest.approx(1.0)
    beside = np.array([[1e-3, 0.0, 0.0]])
    assert distances(quadric(100.0, 100.0), beside)[0][0] > 0.0
    assert distances(quadric(-100.0, -100.0), beside)[0][0] < 0.0
