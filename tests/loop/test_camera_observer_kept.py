"""What is read of the rest frames is kept, and runs that begin from it do not touch each other."""

import numpy as np

from chromagrip import load_scene
from chromagrip.loop.rig import Rig
from chromagrip.sensing import reader


def read(friction: float, frames: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Γ and places of the markers in the first frames of a grasp."""
    rig = Rig(load_scene("margin-60hz", {"object.friction": friction}))
    rig.reset()
    margins, places = [], []
    for _ in range(frames):
        rig.step(2.0)
        sample = rig.sample()
        assert sample.observation is not None
        assert sample.tracks is not None
        margins.append(sample.observation.margin)
        places.append(sample.tracks.position)
    rig.close()
    return np.array(margins), np.array(places)


def test_a_second_grasp_is_the_same_with_what_was_kept_and_without() -> None:
    reader._resting.cache_clear()
    first = read(0.5)
    other = read(0.3)
    again = read(0.5)
    assert reader._resting.cache_info().hits == 2
    reader._resting.cache_clear()
    anew = read(0.3)
    for one, same in ((first, again), (other, anew)):
        np.testing.assert_array_equal(one[0], same[0])
        np.testing.assert_array_equal(one[1], same[1])
