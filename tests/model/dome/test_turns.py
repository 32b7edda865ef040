"""Turns of rigid bodies against SciPy's rotations."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from chromagrip.model.dome import rotation_of_quaternion, rotation_vector

PART = st.floats(-1.0, 1.0).filter(lambda value: abs(value) > 1e-3)


@given(st.tuples(PART, PART, PART, PART))
def test_a_quaternion_of_any_length_is_its_rotation(turn: tuple[float, ...]) -> None:
    expected = Rotation.from_quat(turn, scalar_first=True).as_matrix()
    assert np.allclose(rotation_of_quaternion(*turn), expected, atol=1e-14)


@given(st.tuples(PART, PART, PART), st.floats(-9.0, 3.1 / 3.14))
def test_a_rotation_vector_below_half_a_turn_comes_back(
    axis: tuple[float, ...], size: float
) -> None:
    angle = size * 3.14 if size > 0.0 else 10.0**size
    vector = angle * np.array(axis) / np.linalg.norm(axis)
    found = rotation_vector(Rotation.from_rotvec(vector).as_matrix())
    assert np.allclose(found, vector, rtol=1e-6, atol=1e-12)
