"""Contacts of a dome in many poses, drawn as the datasets of domes are."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...dataset.recipe import drawn, load_recipe, pose_of, scene_of
from ...loop.poses.dome_poses import settle_dome
from ...model import SoftBody

Array = NDArray[np.float64]

#: Recipes whose poses are taken in turn.
RECIPES = ("contact-3d", "twist", "edges")


def contact_poses(sensor: str, count: int) -> Iterator[tuple[str, SoftBody, Array]]:
    """Poses of several recipes at their ends, on the dome of a sensor.

    Yields
    ------
    Name of each, the dome, and the forces on its silicone [N], (N, 3).
    """
    for k in range(count):
        recipe, number = load_recipe(RECIPES[k % len(RECIPES)]), k // len(RECIPES)
        values = drawn(recipe, number)
        scene = scene_of(recipe, number, {**values, "sensor": sensor})
        state, _ = settle_dome(scene, pose_of(values, scene))
        yield f"{RECIPES[k % len(RECIPES)]} {number}", scene.build_dome(), state.carried
