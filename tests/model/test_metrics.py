from dataclasses import replace

import numpy as np
import pytest

from chromagrip import model

TIP = model.Fingertip(nodes=11)


def field(contact: list[int], normal: float = 0.1) -> model.ForceField:
    touching = np.isin(np.arange(11), contact)
    return model.ForceField(
        position=TIP.rest_positions(),
        normal=np.where(touching, normal, 0.0),
        friction=np.where(touching, 0.02, 0.0),
        contact=touching,
        totals_covariance=np.zeros((2, 2)),
    )


def followed(record: model.SlipRecord, state: model.State, contact: list[int]) -> model.SlipRecord:
    """Record after a step of 0.01 s that ended in a state with these nodes in contact."""
    d = state.deformation
    run = model.History(
        time=np.zeros(2),
        nodes=np.stack([d.nodes] * 2),
        pose=np.full((2, 2), d.object_position),
        friction=np.zeros((2, 11)),
        slip_rate=np.stack([state.slip_rate] * 2),
        rate=np.zeros((2, 12, 2)),
        step=np.zeros(2),
    )
    (after,) = model.follow_slip(record, run, np.stack([field(contact).contact] * 2), 0.01)
    return after


def test_margin_is_one_in_a_pure_press_and_nan_without_contact() -> None:
    pure = replace(field([4, 6]), friction=np.array([0, 0, 0, 0, 0.04, 0, -0.04, 0, 0, 0, 0.0]))
    assert pure.safety_margin(0.3) == 1.0
    assert np.isnan(field([]).safety_margin(0.3))
    assert np.isnan(pure.safety_margin(0.0))
    assert field([4, 5]).safety_margin(0.5) == pytest.approx(1 - 0.04 / (0.5 * 0.2))


def test_pressure_is_force_over_width() -> None:
    x = TIP.rest_positions()[:, 0]
    assert model.pressure(field([4, 5, 6])) == pytest.approx(0.3 / (x[6] - x[4]))
    assert model.pressure(field([4, 5, 6]), TIP.pitch) == pytest.approx(
        0.3 / (x[6] - x[4] + TIP.pitch)
    )
    assert model.pressure(field([])) == 0.0
    assert np.isnan(model.pressure(field([5])))


def test_displacement_counts_from_where_contact_began() -> None:
    """Elastic shear is not slip: a node that moves with the object has none."""
    state, record = model.rest_state(TIP), model.no_slip(11)
    for position, carried in ((0.0, 0.0), (1e-3, 1e-3), (2e-3, 1.7e-3)):
        nodes = np.zeros((11, 2))
        nodes[5, 0] = carried
        moved = replace(state.deformation, nodes=nodes, object_position=position)
        record = followed(record, replace(state, deformation=moved), [4, 5])
    # Node 4 stayed behind by 2 mm, node 5 by 0.3 mm: the whole contact has slipped 0.3 mm.
    assert record.current == pytest.approx(0.3e-3)
    record = followed(record, replace(state, deformation=moved), [])
    assert record.current == 0.0
    assert record.lateral_displacement == pytest.approx(0.3e-3)


def test_a_contact_that_wanders_along_slips_as_far_as_the_object() -> None:
    """A round object that slides takes its contact along: each node touches it for a while only."""
    state, record = model.rest_state(TIP), model.no_slip(11)

    def slide(first: int, position: float, speed: float) -> None:
        nonlocal record
        moved = replace(state.deformation, object_position=position)
        rates = np.full(11, speed)
        now = replace(state, deformation=moved, slip_rate=rates)
        record = followed(record, now, [first, first + 1, first + 2])

    for k in range(8):  # the back node leaves and another joins with every 0.1 mm
        slide(k, -1e-4 * k, -1e-2 if k else 0.0)
    assert record.current == pytest.approx(0.7e-3)
    for k in range(6, 3, -1):  # what it slides back is taken back
        slide(k, -1e-4 * k, 1e-2)
    assert record.current == pytest.approx(0.4e-3)
    assert record.lateral_displacement == pytest.approx(0.7e-3)
    assert record.rigid_slip == pytest.approx(1.0e-3)


def test_a_contact_that_wanders_without_sliding_does_not_slip() -> None:
    """As a wheel rolls: the object moves on, and each node that joins sticks."""
    state, record = model.rest_state(TIP), model.no_slip(11)
    for k in range(8):
        nodes = np.zeros((11, 2))
        nodes[k : k + 3, 0] = 1e-4 * k - np.arange(3) * 1e-4
        moved = replace(state.deformation, nodes=nodes, object_position=1e-4 * k)
        record = followed(record, replace(state, deformation=moved), [k + 2])
    assert record.lateral_displacement == 0.0


def test_rigid_slip_integrates_the_slowest_node() -> None:
    state, record = model.rest_state(TIP), model.no_slip(11)
    rates = np.zeros(11)
    rates[[4, 5]] = [3e-3, -1e-3]
    for _ in range(10):
        record = followed(record, replace(state, slip_rate=rates), [4, 5])
    assert record.rigid_slip == pytest.approx(1e-4)
