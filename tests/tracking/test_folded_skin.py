"""Markers on skin that folds under a stiff, sharp object, where they come to lie on each other."""

from contextlib import closing

import numpy as np
import pytest
from scipy.spatial import KDTree

from chromagrip.measure.worlds.grasps import LIBRARY, scenes
from chromagrip.model import rest_state
from chromagrip.render.outlines import centroids, outlines


@pytest.mark.stages
@pytest.mark.parametrize("grasp", [37, 62])
def test_markers_that_lay_on_others_are_themselves(grasp: int) -> None:
    """Of random grasps, against where the markers are: none is lost, none is another one."""
    scene = scenes("matched", LIBRARY, grasp)[-1]
    with closing(scene.specimen.camera(0)) as camera:
        view = scene.specimen.sensor.view
        chain = (
            rest_state(scene.specimen.fingertip).deformation.seen,
            scene.state.deformation.seen,
        )
        before, after = (centroids(outlines(camera.membrane(seen), view), False) for seen in chain)
    number = KDTree(before[0]).query(scene.rest.position[0])[1]
    # Discs of the outer layer lie on each other, or did.
    row = np.flatnonzero(abs(before[0, :, 1] - before[0, :, 1].mean()) < 1.0)
    row = row[np.argsort(before[0, row, 0])]
    assert np.diff(after[0, row, 0]).min() < 0.55 * np.diff(before[0, row, 0]).min()
    tracks = scene.tracks[-1]
    assert tracks.visible.all()
    assert np.linalg.norm(tracks.position - after[:, number], axis=-1).max() < 0.3
