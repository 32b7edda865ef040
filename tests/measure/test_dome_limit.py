"""What pictures of a dome can tell: limits that must hold."""

import math
from dataclasses import astuple, replace
from functools import cache

import numpy as np
import pytest
from msgspec import structs

from chromagrip.measure.limits.dials import DIALS
from chromagrip.measure.limits.dome.held import Grip, Held, hold, loads_of, sums_of
from chromagrip.measure.limits.dome.limit import (
    ZONES,
    Noise,
    Seen,
    contact_prior,
    moving_layers,
    sum_weights,
)
from chromagrip.measure.limits.dome.report import NOISES, DomeLimit
from chromagrip.model.dome import lattice
from chromagrip.render import Defects, SensorDesign, load_sensor
from chromagrip.tracking.forces.dome import FRICTION, MOVING, DomeResponse, units_of
from chromagrip.tracking.forces.dome.contact_fit import ContactFit
from chromagrip.tracking.forces.dome.key_shifts import Key, Shifts

GRIP = Grip(normal=3.0, load=1.05, azimuth=0.4, shears=1)


def coarse(name: str, pitch_mm: float) -> SensorDesign:
    """A design on a coarser skin, without defects."""
    sensor = load_sensor(name)
    silicone = structs.replace(sensor.silicone, pitch_mm=pitch_mm)
    return structs.replace(sensor, silicone=silicone, defects=Defects())


#: A layer on the core, and two soft ones on the same dome.
ON_CORE = coarse("dome-2020", 1.6)
SOFT = structs.replace(
    ON_CORE,
    magenta=structs.replace(ON_CORE.magenta, depth_mm=0.8),
    yellow=structs.replace(ON_CORE.yellow, depth_mm=2.2),
)
LIMIT = DomeLimit(design=ON_CORE, levels=2.0, grip=GRIP)
BOUND, MISFIT = LIMIT.noises(2.0).values()


@cache
def held() -> Held:
    return hold(ON_CORE.dome, GRIP)


@cache
def seen(soft: bool) -> Seen:
    return Seen(SOFT if soft else ON_CORE, held())


# ---- the contact ----


def test_forces_are_grip_and_load() -> None:
    load = 1.05 * np.array([math.cos(0.4), math.sin(0.4)])
    np.testing.assert_allclose(held().sums, [*load, 3.0, 0.0, 3.0, 1.05], atol=5e-3)
    assert held().margin == pytest.approx(0.3, abs=3e-3)
    assert len(held().poses) == 2
    ball = hold(ON_CORE.dome, Grip(normal=2.0, load=-0.9, radius=12e-3, shears=2))
    np.testing.assert_allclose(ball.sums[:3], [-0.9, 0.0, 2.0], atol=5e-3)
    assert ball.margin == pytest.approx(0.1, abs=0.02)
    assert len(ball.touching) < len(held().touching)


# ---- a contact that is fitted ----


def test_frames_are_as_good_as_less_noise() -> None:
    once = seen(False).contact(Noise(levels=2.0))
    again = seen(False).contact(Noise(levels=4.0, frames=4, rest_frames=64))
    np.testing.assert_allclose(astuple(again), astuple(once), rtol=1e-9)
    # Where little was known before, four times the frames halve the deviation.
    ratio = seen(False).contact(Noise(levels=0.2, frames=4, rest_frames=64)).moment
    assert ratio / seen(False).contact(Noise(levels=0.2)).moment == pytest.approx(0.5, abs=0.03)


def test_noise_leaves_what_was_known_before_and_none_leaves_nothing() -> None:
    blind = seen(False).contact(Noise(levels=1e9))
    assert blind.mu == pytest.approx(0.5 * 0.6, rel=1e-3)
    clear = seen(False).contact(Noise(levels=1e-4))
    assert clear.normal < 1e-3
    assert clear.margin < 1e-3
    deviations = [
        astuple(seen(False).contact(noise)) for noise in (Noise(levels=1.0), BOUND, MISFIT)
    ]
    assert (np.diff(deviations, axis=0) > 0.0).all()


def test_least_squares_on_drawn_pictures_is_off_by_as_much() -> None:
    """Rest noise that is the same in all pictures is an unknown of its own here."""
    rng, noise = np.random.default_rng(4), Noise(levels=2.0, place_px=0.01, log_size=2e-3)
    slopes, prior = seen(False).contact_slopes(), contact_prior(held())
    pairs, count = len(slopes), slopes.shape[1] // 6
    at_rest = seen(False).noise(Noise(levels=2.0, frames=10**12, rest_frames=16))[:, :6, :6]
    own = seen(False).noise(replace(noise, rest_frames=10**12))
    roots = [np.linalg.cholesky(a) for a in (np.linalg.inv(prior), at_rest)]
    each = [np.linalg.cholesky(own[:, 6 * k : 6 * k + 6, 6 * k : 6 * k + 6]) for k in range(count)]
    unknowns = slopes.shape[2]
    columns = np.zeros((count, pairs, 6, unknowns + 6 * pairs))
    for k in range(count):
        columns[k, ..., :unknowns] = np.linalg.solve(each[k], slopes[:, 6 * k : 6 * k + 6])
        for p in range(pairs):
            here = slice(unknowns + 6 * p, unknowns + 6 * p + 6)
            columns[k, p, :, here] = np.linalg.solve(each[k][p], roots[1][p])
    known = np.zeros((unknowns + 6 * pairs,) * 2)
    known[:unknowns, :unknowns] = prior
    known[unknowns:, unknowns:] = np.eye(6 * pairs)
    flat = columns.reshape(-1, columns.shape[-1])
    gain = np.linalg.solve(flat.T @ flat + known, flat.T)
    draws = 400
    truth = np.zeros((unknowns + 6 * pairs, draws))
    truth[:unknowns] = roots[0] @ rng.normal(size=(unknowns, draws))
    truth[unknowns:] = rng.normal(size=(6 * pairs, draws))
    found = gain @ (flat @ truth + rng.normal(size=(len(flat), draws)))
    off = (found - truth)[:unknowns]
    moved = held().slopes[:, MOVING:] @ off[: -MOVING * count]
    moved += held().slopes[:, :MOVING] @ off[-MOVING:]
    mu = 0.5 * units_of(held().dome)[MOVING + FRICTION] * off[FRICTION]
    stated = seen(False).contact(noise)
    spread = np.sqrt(np.mean([*moved[:4] ** 2, mu**2], axis=1))
    np.testing.assert_allclose(spread, astuple(stated)[:5], rtol=0.12)
    share = held().sums[5] / (0.5 * held().sums[4])
    margin = share * moved[4] / held().sums[4] - moved[5] / (0.5 * held().sums[4])
    margin += share * mu / 0.5
    assert np.sqrt(np.mean(margin**2)) == pytest.approx(stated.margin, rel=0.12)


def test_the_contact_that_is_fitted_reaches_the_bound() -> None:
    """The reconstructor's own fit, with all that is not linear in it, of pictures with noise."""
    rng, noise = np.random.default_rng(1), Noise(levels=2.0, rest_frames=10**12)
    response = DomeResponse(ON_CORE, held().dome, np.stack([ON_CORE.places] * 2))
    fit, covariance = ContactFit(held().dome, response), seen(False).noise(noise)
    used = np.ones(len(covariance), np.bool_)
    off = []
    for _ in range(12):
        keys = []
        for k, pose in enumerate(held().poses):
            here = slice(6 * k, 6 * k + 6)
            root = np.linalg.cholesky(covariance[:, here, here])
            drawn = np.einsum("pij,pj->pi", root, rng.normal(size=(len(root), 6)))
            values = response(np.arange(len(held().linear[k])), held().linear[k]) + drawn
            shifts = Shifts(values=values, whiten=np.linalg.inv(root), used=used)
            keys.append(Key(shifts=shifts, pose=pose))
        found = fit.fit_keys(held().object_, tuple(keys), 6)
        sums = sums_of(held().dome, loads_of(held().dome, found.contact))
        mu = math.exp(found.object_[FRICTION])
        margin = 1.0 - sums[5] / (mu * sums[4])
        off.append([*(sums - held().sums)[:4], mu - 0.5, margin - held().margin])
    reached = np.sqrt(np.mean(np.square(off), axis=0))
    np.testing.assert_allclose(reached, astuple(seen(False).contact(noise)), rtol=0.5)


def test_a_press_alone_hides_friction() -> None:
    pressed = Seen(ON_CORE, hold(ON_CORE.dome, replace(GRIP, load=0.0)))
    # How far the skin slips outwards says a little.
    assert pressed.contact(MISFIT).mu > 3.0 * seen(False).contact(MISFIT).mu
    assert pressed.tractions([MISFIT], pressed.held.touching)[0].mu > 0.2


# ---- free tractions ----


@pytest.mark.parametrize("soft", [False, True])
def test_free_tractions_never_tell_more_than_the_contact(soft: bool) -> None:
    contact = np.array(astuple(seen(soft).contact(BOUND)))
    known, free = (
        np.array(astuple(seen(soft).tractions([BOUND], seen(soft).zone(zone))[0])) for zone in ZONES
    )
    assert (contact < known).all()
    assert (known < free).all()
    # Where the zone is open, one layer alone leaves the whole grip open.
    assert free[2] < 0.5 if soft else free[2] > 1.0
    assert moving_layers(SOFT if soft else ON_CORE, held().dome) == 1 + soft


def test_sums_of_the_forces_of_the_nodes_are_those_of_the_contact() -> None:
    ball = hold(ON_CORE.dome, Grip(normal=2.0, load=0.6, radius=15e-3, azimuth=2.0, shears=1))
    for zone in map(Seen(ON_CORE, ball).zone, ZONES):
        weights, mu = sum_weights(ball, zone)
        sums = np.einsum("snc,nc->s", weights, ball.contact.linear[zone])
        np.testing.assert_allclose(sums[:6], ball.sums, rtol=2e-3, atol=2e-5)
        assert sums[6] == pytest.approx(0.0, abs=1e-6)
        assert 0.45 < mu < 0.5 + 1e-6


def test_free_tractions_are_those_of_the_other_form() -> None:
    """The posterior from the covariance of the pictures, in place of that of the unknowns."""
    zone = held().touching
    dome, nodes = held().dome, lattice(held().dome)
    unit = np.zeros((3 * len(zone), len(nodes.ring), 3))
    for axis in range(3):
        unit[axis::3][np.arange(len(zone)), zone, axis] = 1.0
    response = DomeResponse(SOFT, dome, np.stack([SOFT.places] * 2)).along(
        np.arange(unit.shape[1]), unit
    )
    slopes = response.reshape(len(unit), -1).T
    apart = ((nodes.points[zone][:, None] - nodes.points[zone]) ** 2).sum(axis=-1)
    smooth = np.exp(-0.5 * apart / (0.1 * dome.radius) ** 2) + 1e-6 * np.eye(len(zone))
    traction = 0.25 * dome.young * nodes.areas[zone]
    prior = np.kron(smooth * np.outer(traction, traction), np.eye(3))
    noise = seen(True).noise(MISFIT)[:, -6:, -6:]
    whole = slopes @ prior @ slopes.T
    for p, one in enumerate(noise):
        whole[6 * p : 6 * p + 6, 6 * p : 6 * p + 6] += one
    across = slopes @ prior
    posterior = prior - across.T @ np.linalg.solve(whole, across)
    forward = np.tile([1.0, 0.0, 0.0], len(zone))
    stated = seen(True).tractions([MISFIT], zone)[0]
    # Friction on a plane that lies across the axis is not stiffened.
    assert np.sqrt(forward @ posterior @ forward) == pytest.approx(stated.x, rel=1e-3)


# ---- what is said of a design ----


def test_an_entry_has_the_limits_of_a_prototype() -> None:
    entry = LIMIT.entry()
    assert entry["read_by"] == ["contact"]
    # Targets of an independent prototype: .012 at the bound, some of it by the skin's pitch.
    found = entry["deviations"]["contact"][NOISES[0]]
    assert found["margin"] == pytest.approx(0.012, rel=0.3)
    assert found["normal_n"] < 0.01
    assert entry["moving_layers"] == 1
    assert entry["truth"]["margin"] == pytest.approx(0.3, abs=0.01)


def test_each_dial_changes_what_it_says_and_nothing_else() -> None:
    dials = {name: dial for name, dial in DIALS.items() if dial.value is not None}
    before = {name: dial.value(ON_CORE) for name, dial in dials.items()}
    for name, dial in dials.items():
        wanted = {"outer": 0.2, "inner": 0.8, "camera": 0.3}.get(name, 0.5 * before[name])
        share = wanted / before[name] if dial.multiples else wanted
        changed = dial.change(ON_CORE, share)
        assert dial.value(changed) == pytest.approx(wanted, rel=0.02)
        rest = {other: each.value(changed) for other, each in dials.items() if other != name}
        assert rest == pytest.approx({other: before[other] for other in rest})
