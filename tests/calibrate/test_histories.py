"""Histories that a read-out is trained on: their ranges, their forces, and what is kept of them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from chromagrip.calibrate.histories import RULE, Plan, choose, of_plan, random_plan, snapshots
from chromagrip.calibrate.random_grips import DRIVES, ONSET, random_drive
from chromagrip.calibrate.ranges import (
    RANGES,
    SHAPES,
    Contact,
    Range,
    largest_grip,
    random_contact,
    random_specimen,
)
from chromagrip.model import (
    ContactObject,
    Drive,
    Fingertip,
    PiercedError,
    chain_forces,
    contact_forces,
    rest_state,
    simulate,
)
from chromagrip.model.chain.assembly import chain, contact
from chromagrip.model.chain.plant import march

TIP = Fingertip()


def fills(values: Sequence[float], limits: Range) -> bool:
    """Whether values stay within limits and come within a twentieth of each."""
    low, high = limits
    slack = (high - low) / 20
    return low <= min(values) < low + slack and high - slack < max(values) <= high


def test_objects_fill_their_ranges() -> None:
    rng = np.random.default_rng(0)
    contacts = [random_contact(rng, TIP) for _ in range(1000)]
    objects = [one.obj for one in contacts]
    bristles = [obj.dahl_stiffness for obj in objects]
    dahl = [bristle for bristle in bristles if bristle != RANGES.coulomb_stiffness_n_per_m]
    assert 0.01 < 1.0 - len(dahl) / len(bristles) < 0.1
    for values, limits, log in (
        ([obj.friction for obj in objects], RANGES.friction, False),
        ([obj.stiffness for obj in objects], RANGES.stiffness_n_per_m, True),
        ([obj.curvature for obj in objects], RANGES.curvature_per_m, False),
        ([np.rad2deg(one.tilt) for one in contacts], RANGES.tilt_deg, False),
        ([obj.dahl_exponent for obj in objects], RANGES.dahl_exponent, False),
        ([obj.drag for obj in objects], RANGES.drag_n_s_per_m, True),
        (dahl, RANGES.dahl_stiffness_n_per_m, True),
    ):
        assert fills(*((np.log(values), np.log(limits)) if log else (values, limits)))
    # As sharp as a ridge at most, wherever the fingertip can be.
    for obj in objects:
        if obj.profile is not None and len(obj.profile) > 3:
            x, z = np.array(obj.profile).T
            assert np.gradient(np.gradient(z, x), x).max() <= 1.05 * RANGES.bump_curvature_per_m
    assert {one.shape for one in contacts} == set(SHAPES)
    assert sum(SHAPES.values()) == pytest.approx(1.0)
    assert 0.2 < sum(obj.profile is not None for obj in objects) / len(objects) < 0.35
    usual = [RANGES.usual_stiffness_n_per_m[0] <= obj.stiffness for obj in objects]
    assert np.mean(usual) > 0.75


def test_specimens_vary_about_the_nominal_one() -> None:
    specimens = [random_specimen(np.random.default_rng(k), TIP) for k in range(300)]
    for name, limits in (
        ("membrane_stiffness", RANGES.membrane),
        ("poisson_tissue", RANGES.coupling),
        ("poisson_membrane", RANGES.coupling),
    ):
        shares = np.array([getattr(one, name) / getattr(TIP, name) for one in specimens])
        low, high = limits
        assert ((shares > low - 1e-9) & (shares < high + 1e-9)).all()
        # Most are near the middle: a third of the half-width is a standard deviation.
        assert shares.mean() == pytest.approx(1.0, abs=0.015)
        assert shares.std() == pytest.approx((high - low) / 6.0, rel=0.15)
    damping = [one.damping_node / TIP.damping_node for one in specimens]
    assert fills(np.log(damping), tuple(np.log(RANGES.damping)))
    assert {one.tissue_stiffness for one in specimens} == {TIP.tissue_stiffness}


@pytest.mark.parametrize(("stiffness", "curvature"), [(3.0, 0.0), (160.0, 333.0)])
def test_the_largest_grip_is_held_and_not_far_from_the_end(
    stiffness: float, curvature: float
) -> None:
    obj = ContactObject(stiffness=stiffness, curvature=curvature)
    most = largest_grip(TIP, stiffness, curvature, 0.5 * TIP.radius)
    assert most <= RANGES.grip_n[1]

    def press(grip: float) -> float:
        drive = Drive(times=np.array([0.0, 0.4]), normal=np.array([0.0, grip]), lateral=np.zeros(2))
        run = simulate(TIP, obj, drive, dt=4e-3, duration=0.4, every=100)
        return run.state(-1).deformation.rigid_part

    assert press(most) < TIP.radius
    if curvature > 0.0 and most < RANGES.grip_n[1]:
        with pytest.raises(PiercedError):
            press(3.0 * most)


def test_drives_stay_where_the_object_goes_on() -> None:
    """Grips within their range, and loads not far above the friction limit."""
    rng = np.random.default_rng(1)
    times = 4e-3 * np.arange(101.0)
    kinds, grips = set(), []
    for _ in range(400):
        contact = random_contact(rng, TIP)
        drive, kind = random_drive(rng, contact, times)
        kinds.add(kind)
        assert drive.normal.min() > 0.0
        assert drive.normal.max() <= contact.largest <= RANGES.grip_n[1]
        assert not drive.lateral[times <= ONSET].any()
        cone = np.arctan(contact.obj.friction)
        highest, lowest = (
            np.tan(contact.tilt + side * cone) * drive.normal for side in (1.0, -1.0)
        )
        slack = RANGES.slides_by_n + 1e-9
        assert (drive.lateral <= np.maximum(highest + slack, 0.0)).all(), kind
        assert (drive.lateral >= np.minimum(lowest - slack, 0.0)).all()
        grips.append(drive.normal.max())
    assert kinds == set(DRIVES)
    low, high = RANGES.usual_grip_n
    assert np.mean([low <= grip <= high for grip in grips]) > 0.6
    assert max(grips) > 0.9 * RANGES.grip_n[1]
    assert min(grips) < 2.0 * RANGES.grip_n[0]


@pytest.mark.parametrize("shape", ["round", "tilted"])
def test_kept_forces_are_those_of_the_model(shape: str) -> None:
    """Against every step of the chain and `contact_forces`, one state at a time."""
    number, plan = next(
        (number, plan)
        for number in range(1000)
        if (plan := random_plan(TIP, number)).contact.shape == shape
    )
    found = of_plan(plan, number)
    assert list(SHAPES)[found.kind[0] // len(DRIVES)] == shape
    obj = plan.contact.obj
    tip, drive = plan.fingertip, plan.drive
    steps = round(float(drive.times[-1]) / plan.dt)
    run = march(chain(tip), contact(tip, obj), rest_state(tip), drive, plan.dt, steps, 1, RULE)
    states = [run.state(k) for k in range(len(run))]
    seen = np.array([state.deformation.seen for state in states])
    for k in range(len(found.history)):
        at = int(abs(seen - found.displacement[k]).max(axis=(1, 2)).argmin())
        assert found.displacement[k] == pytest.approx(seen[at], abs=1e-9)
        field = contact_forces(tip, obj, states[at])
        assert found.normal[k] == pytest.approx(field.normal, rel=1e-5, abs=1e-7)
        assert found.friction[k] == pytest.approx(field.friction, rel=1e-5, abs=1e-7)
        assert found.totals[k, 0] == pytest.approx(field.total_normal)
        assert abs(found.totals[k, 1]) == pytest.approx(field.total_friction)
    assert (found.totals[:, 2] == obj.friction).all()
    assert (found.material == [obj.dahl_stiffness, obj.dahl_exponent, obj.stiffness]).all()


def standing(contact: Contact, grip: float, load: float) -> Plan:
    """Plan of a load that is put on slowly and stands."""
    times = 4e-3 * np.arange(201.0)
    drive = Drive(
        times=times,
        normal=grip * np.minimum(times / 0.1, 1.0),
        lateral=load * np.clip((times - 0.1) / 0.2, 0.0, 1.0),
    )
    specimen = random_specimen(np.random.default_rng(5), TIP)
    return Plan(specimen, contact, drive, 0, 4e-3)


def test_at_rest_friction_is_the_load_and_the_chain_holds_it() -> None:
    """By the springs of that specimen: 1 % of Poisson factor or membrane shows."""
    obj = ContactObject(stiffness=300.0, friction=0.6, drag=30.0)
    plan = standing(Contact(obj, "flat", 0.0, 16.0), 2.0, 0.7)
    found = of_plan(plan, 0)
    load = found.friction.sum(axis=1)
    rests = abs(load - 0.7) < 0.01
    assert rests.sum() >= 3
    assert found.normal.sum(axis=1)[rests] == pytest.approx(2.0, rel=1e-3)
    for seen, normal, friction in zip(
        found.displacement[rests], found.normal[rests], found.friction[rests], strict=True
    ):
        held = chain_forces(plan.fingertip, seen.astype(float))[1:-1]
        assert held[:, 1] == pytest.approx(-normal[1:-1], abs=2e-3)
        assert held[:, 0] == pytest.approx(friction[1:-1], abs=2e-3)


@pytest.mark.parametrize(("side", "tilt"), [(-1.0, 0.15), (1.0, -0.2)])
def test_a_tilted_plane_slides_beyond_the_limit_that_drives_keep(side: float, tilt: float) -> None:
    x = (-0.02, 0.0, 0.02)
    surface = tuple((place, float(np.tan(tilt)) * place) for place in x)
    obj = ContactObject(friction=0.5, drag=30.0, profile=surface)
    limit = float(np.tan(tilt + side * np.arctan(0.5)))
    contact = Contact(obj, "tilted", tilt, 16.0)
    margins = []
    for share in (0.8, 1.05):
        middle = float(np.tan(tilt))
        plan = standing(contact, 2.0, 2.0 * (middle + share * (limit - middle)))
        found = of_plan(plan, 0)
        normal, friction, _ = found.totals.T
        margins.append((1.0 - abs(friction) / (0.5 * normal)).min())
    assert margins[0] > 0.1
    assert margins[1] < 0.01


def test_instants_are_kept_soon_after_a_step_and_long_after() -> None:
    time = 8e-3 * np.arange(60.0)
    forces = np.column_stack([np.where(time < 0.2, 1.0, 3.0), np.full(60, 0.4)])
    margin = np.where(time < 0.2, 0.2, 0.7)
    margin[5] = np.nan
    for seed in range(5):
        kept = choose(np.random.default_rng(seed), time, margin, 0.5, forces)
        since = time[kept] - 0.2
        assert ((since >= 0.0) & (since < 0.03)).any()
        assert (since > 0.08).any()
        assert (since < 0.0).any()
        assert 5 not in kept
        assert len(set(kept.tolist())) == len(kept)


def test_histories_respect_the_cone_and_those_that_cannot_be_followed_are_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = snapshots(TIP, range(40))
    normal, friction, mu = found.totals.T
    assert (abs(found.friction) <= found.totals[:, 2:] * found.normal + 1e-6).all()
    assert normal.min() > 0.0
    margin = 1.0 - abs(friction) / (mu * normal)
    shares = np.histogram(margin, bins=4, range=(-1e-9, 1.0))[0] / len(margin)
    assert shares.min() > 0.08
    assert len(set(found.history.tolist())) > 35
    sharp = Contact(ContactObject(stiffness=5.0, curvature=333.0), "round", 0.0, 16.0)

    def sometimes(fingertip: Fingertip, number: int) -> Plan:
        plan = random_plan(fingertip, number)
        return standing(sharp, 5.0, 0.0) if number == 1 else plan

    monkeypatch.setattr("chromagrip.calibrate.histories.random_plan", sometimes)
    few = snapshots(TIP, range(3))
    assert set(few.history.tolist()) == {0, 2}
    # A history is the same in any batch.
    for number in (0, 2):
        for name, values in vars(few).items():
            kept = vars(found)[name][found.history == number]
            assert np.array_equal(values[few.history == number], kept), name


def test_numbers_of_one_block_are_of_one_specimen() -> None:
    tips = [random_plan(TIP, number).fingertip for number in (64, 95, 96)]
    assert tips[0] == tips[1] != tips[2]
    varied = ("membrane_stiffness", "poisson_tissue", "poisson_membrane", "damping_node")
    assert replace(tips[2], **{name: getattr(TIP, name) for name in varied}) == TIP
