"""Compiled projection of points through the silicone's surface and a lens onto pixels."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compiled import njit

Array = NDArray[np.float64]
Distortion = tuple[float, float, float, float, float]

#: Newton steps to the point where a ray passes the surface; it converges in fewer.
_STEPS = 12


class Lens(NamedTuple):
    """A camera in OpenCV's parameters; see `camera` for the formulas.

    Attributes
    ----------
    fisheye: whether the distortion is a fisheye's (k₁…k₄, 0), else a pinhole's (k₁, k₂, p₁, p₂, k₃)
    focal_x, focal_y: focal lengths [px]
    centre_x, centre_y: pixel on the optical axis
    distortion: the five distortion coefficients
    """

    fisheye: bool
    focal_x: float
    focal_y: float
    centre_x: float
    centre_y: float
    distortion: Distortion


class Port(NamedTuple):
    """Surface of the silicone that the camera looks through.

    Attributes
    ----------
    position: height of the camera on the axis of the sensor frame [m]
    size: radius of the spherical hollow around the origin, or height of a flat port [m]
    flat: whether the port is a plane
    refraction: refractive index of the silicone
    bends: whether refraction changes the image
    """

    position: float
    size: float
    flat: bool
    refraction: float
    bends: bool


#: tan(π/8): up to it the polynomial below is arctan(r)/r in r², within float64's rounding.
_EIGHTH = 0.41421356237309503
_ARCTAN = (
    1.0, -0.3333333333332844, 0.1999999999885503, -0.14285714180969927, 0.11111106180217024,
    -0.09090773069847617, 0.07689953432326606, -0.06640233406965348, 0.056883465843460344,
    -0.04348044719798647, 0.02113528192312993,
)  # fmt: skip

#: A camera that looks along z from the origin through air.
NO_PORT = Port(0.0, 0.0, False, 1.0, False)


@njit()
def pixel(x: float, y: float, z: float, lens: Lens) -> tuple[float, float]:
    """Project a point of the camera's frame [m] to a pixel; NaN behind a pinhole camera."""
    if lens.fisheye:
        u, v = _fisheye(x, y, z, lens.distortion)
    elif z > 0.0:
        u, v = _pinhole(x / z, y / z, lens.distortion)
    else:
        u, v = math.nan, math.nan
    return lens.centre_x + lens.focal_x * u, lens.centre_y + lens.focal_y * v


@njit(inline="always")
def angle_to_axis(rho: float, z: float) -> float:
    """Angle from the optical axis [rad], atan2(rho, z), of a point at distance rho ≥ 0 from it.

    It has no branches, so that loops vectorise. A library's atan2 differs between machines.
    """
    up = abs(z)
    less, more = min(rho, up), max(rho, up)
    beyond = less > _EIGHTH * more  # arctan(t) = π/4 + arctan((t − 1)/(t + 1))
    over, under = (less - more, less + more) if beyond else (less, more)
    r = over / (under if under > 0.0 else 1.0)
    t = r * r
    total = _ARCTAN[10]
    total = total * t + _ARCTAN[9]
    total = total * t + _ARCTAN[8]
    total = total * t + _ARCTAN[7]
    total = total * t + _ARCTAN[6]
    total = total * t + _ARCTAN[5]
    total = total * t + _ARCTAN[4]
    total = total * t + _ARCTAN[3]
    total = total * t + _ARCTAN[2]
    total = total * t + _ARCTAN[1]
    total = total * t + _ARCTAN[0]
    angle = r * total + (0.25 * math.pi if beyond else 0.0)
    angle = 0.5 * math.pi - angle if rho > up else angle
    return math.pi - angle if z < 0.0 else angle


@njit()
def _fisheye(x: float, y: float, z: float, k: Distortion) -> tuple[float, float]:
    """Image point of a fisheye at focal length 1, from a point of the camera's frame."""
    rho = math.sqrt(x * x + y * y)
    angle = angle_to_axis(rho, z)
    t = angle * angle
    bent = angle * (1.0 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3]))))
    scale = bent / max(rho, 1e-300)  # on the axis x and y are 0, whatever the scale
    return scale * x, scale * y


@njit()
def _pinhole(x: float, y: float, k: Distortion) -> tuple[float, float]:
    """Distorted image point of a pinhole at focal length 1, from the undistorted one."""
    t = x * x + y * y
    scale = 1.0 + t * (k[0] + t * (k[1] + t * k[4]))
    return (
        x * scale + 2.0 * k[2] * x * y + k[3] * (t + 2.0 * x * x),
        y * scale + k[2] * (t + 2.0 * y * y) + 2.0 * k[3] * x * y,
    )


@njit()
def apparent(x: float, y: float, z: float, port: Port) -> tuple[float, float, float]:
    """Apparent position of a refracted point, relative to the camera [m].

    It lies at the point's distance, in the direction of the ray at the camera. The ray passes the
    port at the point q of the shortest optical path (Fermat), in the plane of point and axis.
    """
    up = z - port.position
    if not port.bends:
        return x, y, up
    rho = math.sqrt(x * x + y * y)
    distance = math.sqrt(rho * rho + up * up)
    along, steep = rho / distance, up / distance
    if port.flat:
        place = along / steep * (port.size - port.position)
    else:
        half = port.position * steep
        reach = math.sqrt(half * half + port.size**2 - port.position**2) - half
        place = math.atan2(reach * along, port.position + reach * steep)
    for _ in range(_STEPS):
        place -= _newton_step(place, rho, z, port)
    q_rho, q_z = (place, port.size) if port.flat else _on_sphere(place, port.size)
    q_z -= port.position
    scale = distance / math.sqrt(q_rho * q_rho + q_z * q_z)
    share = q_rho * scale / (rho if rho > 0.0 else 1.0)
    return share * x, share * y, q_z * scale


@njit()
def _on_sphere(place: float, radius: float) -> tuple[float, float]:
    """Coordinates (ρ, z) of the port's point at an angle from the axis [rad]."""
    return radius * math.sin(place), radius * math.cos(place)


@njit()
def _newton_step(place: float, rho: float, z: float, port: Port) -> float:
    """Newton step of the port's point towards the shortest optical path to (ρ, z)."""
    if port.flat:
        q_rho, q_z, t_rho, t_z, c_rho, c_z = place, port.size, 1.0, 0.0, 0.0, 0.0
    else:
        q_rho, q_z = _on_sphere(place, port.size)
        t_rho, t_z, c_rho, c_z = q_z, -q_rho, -q_rho, -q_z
    slope = bend = 0.0
    for start_rho, start_z, index in ((0.0, port.position, 1.0), (rho, z, port.refraction)):
        leg_rho, leg_z = q_rho - start_rho, q_z - start_z
        length = math.sqrt(leg_rho * leg_rho + leg_z * leg_z)
        part = (leg_rho * t_rho + leg_z * t_z) / length
        slope += index * part
        square = t_rho * t_rho + t_z * t_z - part * part
        bend += index * (square + leg_rho * c_rho + leg_z * c_z) / length
    return slope / bend


@njit()
def apparent_points(points: Array, port: Port, out: Array) -> None:
    """Apply `apparent` to K points, into `out`, both (K, 3)."""
    for k in range(len(points)):
        out[k, 0], out[k, 1], out[k, 2] = apparent(points[k, 0], points[k, 1], points[k, 2], port)


@njit()
def project_points(points: Array, port: Port, lens: Lens, out: Array) -> None:
    """Project points (K, 3) [m] to pixels, into `out` (K, 2)."""
    for k in range(len(points)):
        x, y, z = apparent(points[k, 0], points[k, 1], points[k, 2], port)
        out[k, 0], out[k, 1] = pixel(x, y, z, lens)


@njit()
def project_lanes(x: Array, y: Array, z: Array, port: Port, lens: Lens) -> None:
    """Project points in place: coordinates [m] become pixels in x and y; z is overwritten.

    The same as `apparent` and `pixel`, in loops that vectorise without refraction.
    """
    if port.bends:
        for k in range(x.shape[0]):
            x[k], y[k], z[k] = apparent(x[k], y[k], z[k], port)
    else:
        for k in range(x.shape[0]):
            z[k] -= port.position
    if lens.fisheye:
        for k in range(x.shape[0]):
            u, v = _fisheye(x[k], y[k], z[k], lens.distortion)
            x[k] = lens.centre_x + lens.focal_x * u
            y[k] = lens.centre_y + lens.focal_y * v
    else:
        for k in range(x.shape[0]):
            x[k], y[k] = pixel(x[k], y[k], z[k], lens)
