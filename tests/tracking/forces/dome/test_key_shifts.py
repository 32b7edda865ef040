"""Shifts of a key frame, and a contact's derivatives on the way to it."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from chromagrip.model.dome import PosedContact
from chromagrip.render import load_sensor
from chromagrip.tracking.forces.dome.contact_state import MOVING, PRESS, prior_of
from chromagrip.tracking.forces.dome.contact_way import Changes, ContactWay
from chromagrip.tracking.forces.dome.key_shifts import Explained, Shifts

Array = NDArray[np.float64]
#: Pairs, of which some are seen, and independent values of each.
PAIRS, VALUES = 9, 4
RNG = np.random.default_rng(31)
USED = np.arange(PAIRS) % 3 > 0
SHIFTS = Shifts(
    values=RNG.normal(size=(USED.sum(), 6)),
    whiten=RNG.normal(size=(USED.sum(), VALUES, 6)),
    used=USED,
)


def test_every_pair_is_whitened_by_its_own_matrix() -> None:
    several = RNG.normal(size=(3, USED.sum(), 6))
    whole = SHIFTS.apply(several)
    for one, row in zip(several, whole, strict=True):
        each = [matrix @ pair for matrix, pair in zip(SHIFTS.whiten, one, strict=True)]
        np.testing.assert_allclose(row, np.concatenate(each), atol=1e-12)
        np.testing.assert_allclose(SHIFTS.apply(one), row, atol=1e-12)


def test_the_gradient_is_that_of_the_loss() -> None:
    predicted, slopes = RNG.normal(size=(PAIRS, 6)), RNG.normal(size=(12, PAIRS, 6))

    def explained(shown: Array) -> Explained:
        return Explained(shifts=SHIFTS, predicted=shown, whole=SHIFTS.apply(slopes[:, USED]))

    information, gradient = explained(predicted).normal
    small = 1e-6
    for k, slope in enumerate(slopes):
        ends = [explained(predicted + sign * small * slope).loss for sign in (1.0, -1.0)]
        np.testing.assert_allclose(gradient[k], -(ends[0] - ends[1]) / (4.0 * small), rtol=1e-5)
    assert np.linalg.eigvalsh(information).min() > -1e-9


def test_noise_and_a_few_outliers_make_no_object_unlike_and_few_pairs_tell_nothing() -> None:
    count, rng = 400, np.random.default_rng(5)
    whiten, moved = np.tile(np.eye(3, 6), (count, 1, 1)), np.arange(count) < count // 2
    values = np.where(moved[:, None], 10.0, 0.0).repeat(6, axis=1)
    shifts = Shifts(values=values, whiten=whiten, used=np.ones(count, bool))
    noise = rng.normal(size=(count, 3))

    def odd(residual: Array) -> float:
        return shifts.odd_misfit(residual.ravel())

    # Whatever the variances are that tracks say they have.
    for scale in (0.1, 1.0):
        assert odd(scale * noise) < 0.1
    outliers = np.where(np.arange(count) % 10 == 0, 30.0, 0.0)[:, None]
    assert odd(0.1 * noise + outliers) < 0.1
    contradicted = np.where(moved & (np.arange(count) % 3 == 0), 1.0, 0.0)[:, None]
    assert odd(0.1 * noise + contradicted) > 0.9
    few = replace(shifts, values=np.where(np.arange(count)[:, None] < 5, values, 0.0))
    assert math.isnan(few.odd_misfit(noise.ravel()))


def test_a_solved_contact_has_the_changes_of_one_that_is_solved_again() -> None:
    dome = load_sensor("dome-2022").dome
    object_, rest, pose = prior_of(dome).mean, np.zeros(MOVING), np.zeros(MOVING)
    pose[PRESS], pose[0] = 0.1 * dome.thickness, 0.02 * dome.thickness

    def changes(solved: bool) -> tuple[PosedContact, Changes]:
        way = ContactWay(dome)
        contact = way.step(way.untouched(object_), object_, rest, pose)
        return way.step_and_changes(
            way.untouched(object_), None, object_, rest, pose, alike=contact, solved=solved
        )

    contact, known = changes(solved=True)
    again, fresh = changes(solved=False)
    assert contact.forces.any()
    np.testing.assert_allclose(contact.forces, again.forces, atol=1e-3 * abs(again.forces).max())
    most = abs(fresh.linear).max(axis=(1, 2), keepdims=True)
    assert (abs(known.linear - fresh.linear) < 0.01 * most).all()
