"""The camera of one specimen, fitted to the places of its markers in the rest frame.

A calibration leaves half a pixel and some tenths of a percent, and layers are never quite aligned.
Both move the resting markers off the design's places, each in its own pattern. If one were taken
for the other, places on the skin would be wrong.
"""

import dataclasses

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from ...render import FisheyeCamera, PinholeCamera, SensorDesign
from ...render.design import CameraSettings
from ..tracks import Tracks

Array = NDArray[np.float64]

#: Prior standard deviation of the image's middle [px].
_CENTRE = 2.0
#: Prior standard deviation of the focal length, as a share of it.
_FOCAL = 0.01
#: Prior standard deviation of a layer's turn about each axis [rad].
_TURN = 0.03
#: Standard deviation of a marker's place, as stencils leave it [px].
_PLACE = 0.5
#: Largest distance of a marker from the design's nearest place, as a share of the pitch.
_NEAR = 0.35
#: Smallest number of such markers in each layer.
_LEAST = 30


def fitted_to_rest(sensor: SensorDesign, rest: Tracks) -> SensorDesign:
    """The design with its camera's middle and focal length fitted to the resting markers.

    Parameters
    ----------
    sensor: calibration of the image, whose layout the specimen was made to
    rest: tracks of the unloaded sensor

    Returns
    -------
    The same design where too few markers lie near its places, or on a flat pad, where a shift of
    the camera and one of a layer look the same.
    """
    skin, camera = sensor.shape, sensor.camera.build()
    if skin.flat or not isinstance(camera, FisheyeCamera | PinholeCamera):
        return sensor
    points, pixels = [], []
    for depth, position, visible in zip(sensor.depths, rest.position, rest.visible, strict=True):
        designed = skin.points(sensor.places, depth)
        tree = KDTree(sensor.view.project(designed))
        pitch = float(np.median(np.asarray(tree.query(tree.data, k=2)[0])[:, 1]))
        distance, nearest = tree.query(position[visible])
        near = np.asarray(distance) < _NEAR * pitch
        if near.sum() < _LEAST:
            return sensor
        points.append(designed[np.asarray(nearest)[near]])
        pixels.append(position[visible][near])

    def settings(x: Array) -> CameraSettings:
        return replace(
            sensor.camera,
            model="fisheye" if isinstance(camera, FisheyeCamera) else "pinhole",
            focal_px=tuple(float(f * (1.0 + _FOCAL * x[2])) for f in camera.focal),
            centre_px=tuple(float(c + _CENTRE * d) for c, d in zip(camera.centre, x, strict=False)),
            distortion=camera.distortion,
            calibration="",
        )

    def residual(x: Array) -> Array:
        view = dataclasses.replace(sensor.view, camera=settings(x).build())
        error = [
            view.project(Rotation.from_rotvec(_TURN * turn).apply(p)) - q
            for p, q, turn in zip(points, pixels, x[3:].reshape(2, 3), strict=True)
        ]
        return np.concatenate([np.concatenate(error).ravel() / _PLACE, x])

    fitted = least_squares(residual, np.zeros(9), loss="soft_l1").x
    return replace(sensor, camera=settings(fitted))
