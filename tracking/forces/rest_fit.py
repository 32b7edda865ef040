"""The camera as one specimen's rest frame shows it: where its markers sit says where it looks.

A calibration leaves half a pixel and some tenths of a percent, and layers are never quite aligned.
Either moves the resting markers off the design's places, each in its own pattern; taken one for
the other, the skin would be thought to have moved where it has not.
"""

import dataclasses

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from ...render import FisheyeCamera, PinholeCamera, SensorDesign
from ...render.design.sensor import CameraSettings
from ..tracks import Tracks

Array = NDArray[np.float64]

#: Standard deviations before the rest frame: middle of the image [px], focal length, and turns of a
#: layer [rad].
_CENTRE, _FOCAL, _TURN = 2.0, 0.01, 0.03
#: Of a marker's place on the skin, made as well as stencils are [px].
_PLACE = 0.5
#: A marker belongs to the design's nearest place within this share of the pitch.
_NEAR = 0.35
#: Fewer markers than this in either layer say too little of the camera.
_LEAST = 30


def fitted_to_rest(sensor: SensorDesign, rest: Tracks) -> SensorDesign:
    """The design with its camera's middle and focal length fitted to the resting markers.

    Parameters
    ----------
    sensor: calibration of the image, whose layout the specimen was made to
    rest: tracks of the unloaded sensor

    Returns
    -------
    The same design where too few markers lie near its places, or on a flat pad, where a camera
    that looks elsewhere and a shifted layer are one.
    """
    skin, camera = sensor.shape, sensor.camera.build()
    if skin.flat or not isinstance(camera, FisheyeCamera | PinholeCamera):
        return sensor
    points, seen = [], []
    for depth, position, visible in zip(sensor.depths, rest.position, rest.visible, strict=True):
        designed = skin.points(sensor.places, depth)
        tree = KDTree(sensor.view.project(designed))
        pitch = float(np.median(np.asarray(tree.query(tree.data, k=2)[0])[:, 1]))
        apart, nearest = tree.query(position[visible])
        near = np.asarray(apart) < _NEAR * pitch
        if near.sum() < _LEAST:
            return sensor
        points.append(designed[np.asarray(nearest)[near]])
        seen.append(position[visible][near])

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
        off = [
            view.project(Rotation.from_rotvec(_TURN * turn).apply(p)) - q
            for p, q, turn in zip(points, seen, x[3:].reshape(2, 3), strict=True)
        ]
        return np.concatenate([np.concatenate(off).ravel() / _PLACE, x])

    found = least_squares(residual, np.zeros(9), loss="soft_l1").x
    return replace(sensor, camera=settings(found))
