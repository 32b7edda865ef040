"""Force field from tracks on a dome whose two layers of markers both move: free tractions.

Two soft layers at different depths show tractions of the skin almost where they act. So no object
is looked for: any pressing tractions within a zone that the markers tell (`fit`) are
parted into normal force and friction by the surface that the skin lies on (`skin`).
"""

import math

import numpy as np
from numpy.typing import NDArray

from .....errors import UserError
from .....model import ForceField, FrictionReading
from .....model.dome import lattice
from .....render import layer_depths
from ....tracks import Tracks
from ...calibration import SensorCalibration
from ...reconstructors import NoEstimateError
from ...shifts import MarkerShifts
from ...silicone_values import ON_CORE, SILICONE_ERROR
from ..marker_response import DomeResponse
from ..untouched import untouched_field
from .fit import Frame, TractionFit, Tractions
from .friction import Slip, read_slip
from .silicone import Sums, UnsureSilicone
from .skin import Parted, Skin

Array = NDArray[np.float64]

#: Fewer visible pairs than this do not determine tractions.
MIN_MARKERS = 40
#: Pairs up to this angle from the apex are read [rad].
_REACH = math.pi / 2
#: Nodes up to this angle from the apex are prepared before the first frame [rad].
_PREPARED = math.radians(28.0)
#: Largest mean square of what is left of the shifts, in deviations, and as a share of the shifts.
_MISFIT, _LEFT = 4.0, 0.02
#: µ before one has been observed, and share by which it may be off.
_USUAL, _UNSEEN = 0.5, 0.4
#: Share by which µ may be off to be observable, and the margin from which on it is not.
_OBSERVED, _OBSERVABLE_MARGIN = 0.2, 0.85
#: What the unknown surface leaves unsure, as a share of ΣFn: factors of the squared share of the
#: rim, and of the misfit beyond noise.
_NARROW, _UNEXPLAINED = 0.25, 0.05
#: Other deviations as shares of ΣFn: of ΣFn at least, over the force that stiffening adds, and over
#: the depth of the press in thicknesses, as silicone moves its markers more than the linear one
#: does; of ΣFf; and across the normals, over the force that stiffening adds.
_NORMAL, _STIFFENING, _DEEP, _FRICTION, _TILT = 0.004, 0.1, 0.25, 0.003, 0.006
#: Least deviation of Γ.
_MARGIN = 0.01
#: How far from where it is told the normal force may act, over the radius: at least, and factor of
#: the squared share of the rim.
_ARM = (4e-5, 2.5e-3)


class TractionReading:
    """Reads tractions off the tracks of one dome, frame after frame.

    Parameters
    ----------
    calibration: of the sensor
    rest: tracks of the unloaded sensor

    Attributes
    ----------
    stiffness_deviation: share by which all forces may be off, beside what their covariance says

    Raises
    ------
    UserError
        For a sensor without silicone, a pad, and one whose inner layer lies on its core.
    """

    def __init__(self, calibration: SensorCalibration, rest: Tracks) -> None:
        dome = calibration.sensor.round_dome("reconstructor traction")
        if max(layer_depths(calibration.sensor, dome)) > (1.0 - ON_CORE) * dome.thickness:
            raise UserError(
                "a layer of markers lies on the rigid core, and one moving layer does not tell "
                "tractions; use the reconstructor contact"
            )
        self.dome = dome
        self._shifts = MarkerShifts(calibration, rest, _REACH)
        self._response = DomeResponse(self._shifts.sensor, dome, self._shifts.places)
        nodes = lattice(dome)
        self._prepared = np.flatnonzero(nodes.angles[nodes.ring] < _PREPARED)
        self._response.of_nodes(self._prepared)
        self._skin = Skin(dome)
        self._fit: TractionFit | None = None
        self._silicone: UnsureSilicone | None = None
        self.stiffness_deviation = calibration.stiffness_deviation
        if calibration.silicone_covariance:
            self._silicone = UnsureSilicone(calibration, rest, self._shifts.pose, _REACH)
            self.stiffness_deviation = SILICONE_ERROR
        self.reset()

    def reset(self) -> None:
        """Forget the frames before: the next one is sought from rest."""
        self._last: Tractions | None = None
        self._friction = _USUAL
        if self._silicone is not None:
            self._silicone.reset()

    def update(self, tracks: Tracks) -> ForceField:
        """Force field of a frame.

        Raises
        ------
        NoEstimateError
            When fewer than MIN_MARKERS pairs are visible, and when no tractions explain them.
        """
        frame = self._read(tracks)
        assert self._fit is not None
        if not self._fit.touched(frame):
            self.reset()
            return untouched_field(self.dome)
        found = self._fit.fit(frame, self._last)
        if found is not None and self._odd(frame, found) and self._last is not None:
            found = self._fit.fit(frame, None)
        light = not self._fit.touched(frame, clearly=True)
        if found is None and light:
            self.reset()
            return untouched_field(self.dome)
        if found is None or self._odd(frame, found):
            self.reset()
            raise NoEstimateError("no tractions on the skin explain the markers")
        self._last = found
        return self._field(found)

    def _read(self, tracks: Tracks) -> Frame:
        values, certain = self._shifts(tracks, MIN_MARKERS)
        noise = self._shifts.noise(tracks)
        if self._fit is None:
            # Noise of markers hardly changes from frame to frame: that of the first one is kept.
            usual = np.median(noise[certain], axis=0)
            first = np.where(certain[:, None, None], noise, usual)
            places = self._shifts.sensor.shape.points(self._shifts.places[0], 0.0)
            self._fit = TractionFit(
                self.dome, self._response, self._skin.beside, places, first, self._prepared
            )
        return self._fit.frame(values, certain, noise)

    def _odd(self, frame: Frame, found: Tractions) -> bool:
        """Whether tractions do not explain the markers."""
        assert self._fit is not None
        left = found.misfit * frame.count / max(self._fit.cost(frame), 1e-9)
        return found.misfit > _MISFIT and left > _LEFT

    def _field(self, found: Tractions) -> ForceField:
        before = self._friction
        parted = self._skin(found.nodes, found.linear, before)
        net = _across(parted)
        load = float(np.linalg.norm(net))
        slip = read_slip(self.dome, found.nodes, parted.normal, parted.friction, load, parted.rim)
        whole = float(parted.normal.sum())
        margin = 1.0 - load / (slip.friction * whole)
        observable = slip.deviation < _OBSERVED and margin < _OBSERVABLE_MARGIN
        if observable:
            self._friction = slip.friction
        else:
            # Where nothing slips ratios say little, and a µ that is too large would be unsafe.
            usual = min(slip.friction, self._friction)
            slip = Slip(friction=usual, deviation=max(slip.deviation, _UNSEEN))
        points = lattice(self.dome).points
        narrow = math.hypot(_NARROW * parted.rim**2, _UNEXPLAINED * max(found.misfit - 1.0, 0.0))
        inwards = -(parted.displacement * points[found.nodes]).sum(axis=1) / self.dome.radius
        deep = _DEEP * max(float(inwards.max()), 0.0) / self.dome.thickness
        unsure = whole * np.array(
            [
                math.hypot(_NORMAL, _STIFFENING * parted.added, deep, narrow),
                math.hypot(_FRICTION, narrow),
            ]
        )
        slopes = _slopes(parted, net, points[found.nodes])
        spread = found.spread(slopes)
        covariance = spread @ spread.T
        totals = covariance[:2, :2] + np.diag(unsure**2)
        margin_deviation = _margin_deviation(slip, whole, load, totals)
        if self._silicone is not None:
            # What is alike in both sums and in µ leaves Γ as it is: it is told apart.
            more = self._calibrated(found, parted, before, slip, observable)
            covariance, totals = covariance + more[:6, :6], totals + more[:2, :2]
            margin_deviation = math.hypot(margin_deviation, math.sqrt(max(more[6, 6], 0.0)))
        position = points.copy()
        position[found.nodes] += parted.displacement
        return ForceField(
            position=position,
            normal=_on_all(points, found, parted.normal),
            friction=_on_all(points, found, parted.friction),
            contact=_on_all(points, found, np.ones(len(found.nodes), np.bool_)),
            totals_covariance=totals,
            friction_reading=FrictionReading(
                value=slip.friction,
                deviation=slip.deviation * slip.friction,
                observable=observable,
                margin_deviation=margin_deviation,
            ),
            directions=_on_all(points, found, parted.directions),
            wrench_covariance=covariance[2:, 2:] + self._unsure_wrench(parted, unsure[0], narrow),
        )

    def _calibrated(
        self, found: Tractions, parted: Parted, before: float, slip: Slip, observable: bool
    ) -> Array:
        """Covariance that the calibration leaves, see `UnsureSilicone`, shape (7, 7).

        Parameters
        ----------
        before: µ that the forces were parted with
        slip: what was read, or taken where µ is not `observable`
        """
        assert self._fit is not None
        assert self._silicone is not None
        points = lattice(self.dome).points[found.nodes]

        def read(skin: Skin, linear: Array) -> Sums:
            other, mu = skin(found.nodes, linear, before), slip.friction
            if observable:
                load, both = float(np.linalg.norm(_across(other))), (other.normal, other.friction)
                mu = read_slip(self.dome, found.nodes, *both, load, other.rim).friction
            return _sums(other, points, mu)

        sums = _sums(parted, points, slip.friction)
        return self._silicone(self._fit, self._response, found, sums, read)

    def _unsure_wrench(self, parted: Parted, unsure: float, narrow: float) -> Array:
        """Covariance of force and torque about z that the unknown surface leaves, shape (4, 4).

        Normals that are wrong change how much is stiffened, and where to.
        """
        out, whole = np.zeros((4, 4)), float(parted.normal.sum())
        tilted = whole * parted.added * math.hypot(_TILT, narrow)
        out[:3, :3] = unsure**2 * np.outer(parted.axis, parted.axis) + tilted**2 * np.eye(3)
        arm = self.dome.radius * math.hypot(_ARM[0], _ARM[1] * parted.rim**2)
        out[3, 3] = (arm * whole) ** 2
        return out


def _across(parted: Parted) -> Array:
    """Friction that counts in Γ [N], shape (3,), see `ForceField.net_friction`."""
    whole, axis = parted.friction.sum(axis=0), parted.axis
    return np.asarray(whole - axis * (whole @ axis))


def _sums(parted: Parted, points: Array, friction: float) -> Sums:
    """What is read off forces on nodes at rest at points (n, 3), with a µ."""
    forces = parted.normal[:, None] * parted.directions + parted.friction
    x, y, _ = (points + parted.displacement).T
    net, whole = _across(parted), float(parted.normal.sum())
    load = float(np.linalg.norm(net))
    torque = float((x * forces[:, 1] - y * forces[:, 0]).sum())
    return Sums(
        values=np.array([whole, load, *forces.sum(axis=0), torque]),
        margin=1.0 - load / (friction * whole),
        net=net,
        middle=parted.normal @ points / whole,
    )


def _slopes(parted: Parted, net: Array, points: Array) -> Array:
    """Slopes of ΣFn, ΣFf, Fx, Fy, Fz and Mz by the forces of the linear skin, shape (6, n, 3)."""
    directions = parted.directions
    side = net / max(float(np.linalg.norm(net)), 1e-12)
    axes = np.concatenate([side[None], np.eye(3)])
    along = axes @ directions.T
    across = axes[:, None] - along[..., None] * directions
    normal = parted.stiffening[:, None] * directions
    forces = across[1:] + along[1:, :, None] * normal
    places = points + parted.displacement
    torque = places[:, :1] * forces[1] - places[:, 1:2] * forces[0]
    return np.concatenate([normal[None], across[:1], forces, torque[None]])


def _margin_deviation(slip: Slip, whole: float, load: float, totals: Array) -> float:
    """Deviation of Γ from those of µ and the sums."""
    share = load / (slip.friction * whole)
    slope = np.array([share / whole, -1.0 / (slip.friction * whole)])
    sums = math.sqrt(max(float(slope @ totals @ slope), 0.0))
    return math.hypot(share * slip.deviation, sums, _MARGIN)


def _on_all(points: Array, found: Tractions, values: NDArray[np.generic]) -> NDArray:  # type: ignore[type-arg]
    """Values of the nodes in contact among those of all nodes, which are zero."""
    out = np.zeros((len(points), *values.shape[1:]), values.dtype)
    out[found.nodes] = values
    return out
