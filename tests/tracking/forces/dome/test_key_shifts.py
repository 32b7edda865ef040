"""Shifts of a key frame, and a contact's derivatives on the way to it."""

import math
from dataclasses import replace

import numpy as np
import pytest
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


def test_a_few_outliers_do_not_make_an_object_unlike_and_no_verdict_is_built_on_a_few_pairs() -> (
    None
):
    whiten, none = np.tile(np.eye(3, 6), (20, 1, 1)), np.zeros((20, 6))
    shifts = Shifts(values=np.full((20, 6), 10.0), whiten=whiten, used=np.ones(20, bool))

    def odd(residual: Array) -> float:
        return shifts.odd_misfit(np.repeat(residual, 3))

    assert odd(np.r_[np.full(3, 30.0), np.full(17, 0.1)]) == pytest.approx(0.01)
    assert odd(np.r_[np.full(6, 1.0), np.full(14, 0.1)]) == pytest.approx(1.0)
    few = replace(shifts, values=np.where(np.arange(20)[:, None] < 5, 10.0, none))
    assert math.isnan(few.odd_misfit(np.ones(60)))


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
