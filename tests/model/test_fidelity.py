"""No more than the scene needs: each choice of less, and what it costs in accuracy."""

import numpy as np
import pytest

from chromagrip.model import (
    ContactObject,
    Drive,
    Fingertip,
    contact_forces,
    equilibrium,
    rest_ensemble,
    rest_state,
    simulate,
    step,
    step_many,
)

TIP = Fingertip()


def press(grip: float) -> Drive:
    return Drive(times=[0.0, 0.1, 0.3], normal=[0.0, grip, grip], lateral=np.zeros(3))


@pytest.mark.parametrize("obj", [ContactObject(), ContactObject(stiffness=160.0, curvature=50.0)])
def test_half_a_chain_is_the_whole_one(obj: ContactObject) -> None:
    whole, half = (
        simulate(TIP, obj, press(2.0), dt=1e-3, duration=0.3, every=300, half=half)
        for half in (False, True)
    )
    assert half.nodes[-1] == pytest.approx(whole.nodes[-1], abs=1e-9)
    assert half.friction[-1] == pytest.approx(whole.friction[-1], abs=1e-7)
    assert half.pose[-1] == pytest.approx(whole.pose[-1], abs=1e-9)


def test_friction_left_out_of_a_press_changes_the_width_by_its_shear_alone() -> None:
    obj = ContactObject()
    with_it, without = (
        simulate(TIP, obj, press(2.0), dt=1e-3, duration=0.3, every=300, friction=friction)
        for friction in (True, False)
    )
    fields = [contact_forces(TIP, obj, run.state(-1)) for run in (with_it, without)]
    assert fields[1].friction == pytest.approx(np.zeros(TIP.nodes))
    assert fields[1].normal.sum() == pytest.approx(fields[0].normal.sum(), rel=1e-3)
    widths = [np.ptp(field.position[field.contact, 0]) for field in fields]
    assert widths[1] == pytest.approx(widths[0], rel=0.05)


@pytest.mark.parametrize(
    "obj", [ContactObject(), ContactObject(stiffness=80.0, friction=0.7, curvature=50.0)]
)
def test_graded_chain_keeps_the_continuum(obj: ContactObject) -> None:
    graded = Fingertip.graded()
    assert graded.nodes <= 100
    fields = []
    for tip in (TIP, graded):
        state = equilibrium(tip, obj, 2.0, 0.4)
        fields.append(contact_forces(tip, obj, state))
    whole, fewer = fields
    assert fewer.normal.sum() == pytest.approx(whole.normal.sum(), rel=1e-3)
    assert fewer.friction.sum() == pytest.approx(whole.friction.sum(), rel=5e-3)
    assert fewer.contact.sum() == whole.contact.sum()
    # Where both have nodes, the forces are the same.
    middle = slice(graded.nodes // 2 - 20, graded.nodes // 2 + 21)
    same = slice(TIP.nodes // 2 - 20, TIP.nodes // 2 + 21)
    assert fewer.normal[middle] == pytest.approx(whole.normal[same], rel=0.01, abs=5e-4)


@pytest.mark.parametrize(("nodes", "core"), [(99, 11e-3), (98, 6e-3), (61, 6e-3)])
def test_impossible_gradings_are_named(nodes: int, core: float) -> None:
    with pytest.raises(ValueError, match="graded fingertip nodes must be odd and in"):
        Fingertip.graded(nodes, core)


@pytest.mark.parametrize("threads", [1, 3])
def test_an_ensemble_is_its_members(threads: int) -> None:
    tip = Fingertip(nodes=51)
    objects = [
        ContactObject(stiffness=k, friction=mu, curvature=c)
        for k, mu, c in (
            (1000.0, 0.5, 0.0),
            (160.0, 0.3, 50.0),
            (80.0, 0.7, -40.0),
            (500.0, 0.9, 0),
        )
    ]
    grip = np.linspace(0.1, 2.0, 30) * np.array([[1.0], [0.5], [1.5], [0.7]])
    load = 0.1 * grip
    many = step_many(tip, objects, rest_ensemble(tip, 4), 1e-3, grip, load, threads)
    for b, obj in enumerate(objects):
        state = rest_state(tip)
        for k in range(30):
            state = step(tip, obj, state, 1e-3, grip[b, k], load[b, k])
        assert many.state(b).deformation.nodes.tobytes() == state.deformation.nodes.tobytes()
        assert many.state(b).friction.tobytes() == state.friction.tobytes()


def test_an_ensemble_of_other_size_is_refused() -> None:
    tip = Fingertip(nodes=51)
    with pytest.raises(ValueError, match="ensemble of 2 needs as many objects"):
        step_many(tip, [ContactObject()], rest_ensemble(tip, 2), 1e-3, np.ones(2), np.zeros(2))


def test_cost_of_a_step_knows_no_memory_of_its_length() -> None:
    """10 ms steps end where 0.1 ms steps do, Γ and ΣFn within 2 % (loads smooth over a step)."""
    obj = ContactObject(stiffness=160.0, curvature=200.0)
    t = np.linspace(0.0, 0.6, 601)
    rise = np.sin(0.5 * np.pi * np.clip(t / 0.3, 0, 1)) ** 2
    pull = np.sin(0.5 * np.pi * np.clip((t - 0.3) / 0.3, 0, 1)) ** 2
    drive = Drive(times=t, normal=3.0 * rise, lateral=0.6 * pull)
    rows = []
    for dt in (1e-4, 1e-2):
        run = simulate(TIP, obj, drive, dt=dt, duration=0.6, every=round(0.1 / dt))
        fields = [contact_forces(TIP, obj, run.state(k)) for k in range(1, 7)]
        rows.append(
            [(f.normal.sum(), 1 - abs(f.friction.sum()) / (0.5 * f.normal.sum())) for f in fields]
        )
    assert np.array(rows[1]) == pytest.approx(np.array(rows[0]), rel=0.02)
