"""Force field from tracks on a dome with two moving layers of markers: free tractions.

Two soft layers at different depths show tractions of the skin almost where they act. So no object
is fitted. Tractions within a contact zone are fitted to the markers (`fit`), and split into normal
force and friction by the normals of the surface that the skin touches (`skin`).
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
from .settings import TractionSettings
from .silicone import Sums, UnsureSilicone
from .skin import Parted, Skin

Array = NDArray[np.float64]


class TractionReading:
    """Estimates tractions from the tracks of one dome, frame by frame.

    Parameters
    ----------
    calibration: calibration of the sensor
    rest: tracks of the unloaded sensor
    settings: tuned parameters

    Attributes
    ----------
    stiffness_deviation: relative error of all forces, in addition to their covariance

    Raises
    ------
    UserError
        For a sensor without silicone, a pad, and one whose inner layer lies on its core.
    """

    def __init__(
        self,
        calibration: SensorCalibration,
        rest: Tracks,
        settings: TractionSettings = TractionSettings(),
    ) -> None:
        dome = calibration.sensor.round_dome("reconstructor traction")
        if max(layer_depths(calibration.sensor, dome)) > (1.0 - ON_CORE) * dome.thickness:
            raise UserError(
                "a layer of markers lies on the rigid core, and one moving layer does not tell "
                "tractions; use the reconstructor contact"
            )
        self.dome, self._settings = dome, settings
        self._shifts = MarkerShifts(calibration, rest, settings.reach)
        self._response = DomeResponse(self._shifts.sensor, dome, self._shifts.places)
        nodes = lattice(dome)
        self._prepared = np.flatnonzero(nodes.angles[nodes.ring] < settings.prepared)
        self._response.of_nodes(self._prepared)
        self._skin = Skin(dome, settings.skin)
        self._fit: TractionFit | None = None
        self._silicone: UnsureSilicone | None = None
        self.stiffness_deviation = calibration.stiffness_deviation
        if calibration.silicone_covariance:
            self._silicone = UnsureSilicone(calibration, rest, self._shifts.pose, settings)
            self.stiffness_deviation = SILICONE_ERROR
        self.reset()

    def reset(self) -> None:
        """Forget previous frames: the next one is fitted from rest."""
        self._last: Tractions | None = None
        self._friction = self._settings.usual_friction
        if self._silicone is not None:
            self._silicone.reset()

    def update(self, tracks: Tracks) -> ForceField:
        """Estimate the force field of a frame.

        Raises
        ------
        NoEstimateError
            When too few pairs are visible, and when no tractions explain them.
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
        values, certain = self._shifts(tracks, self._settings.least_markers)
        noise = self._shifts.noise(tracks)
        if self._fit is None:
            # Marker noise hardly changes between frames: keep that of the first one.
            usual = np.median(noise[certain], axis=0)
            first = np.where(certain[:, None, None], noise, usual)
            places = self._shifts.sensor.shape.points(self._shifts.places[0], 0.0)
            self._fit = TractionFit(
                self.dome, self._response, self._skin.beside, places, first, self._prepared,
                self._settings.fit,
            )  # fmt: skip
        return self._fit.frame(values, certain, noise)

    def _odd(self, frame: Frame, found: Tractions) -> bool:
        """Whether tractions do not explain the markers."""
        settings = self._settings
        assert self._fit is not None
        left = found.misfit * frame.count / max(self._fit.cost(frame), 1e-9)
        return found.misfit > settings.misfit and left > settings.residual_share

    def _field(self, found: Tractions) -> ForceField:
        settings = self._settings
        before = self._friction
        parted = self._skin(found.nodes, found.linear, before)
        net = _across(parted)
        load = float(np.linalg.norm(net))
        slip = read_slip(
            self.dome, found.nodes, parted.normal, parted.friction, load, parted.rim, settings.slip
        )
        whole = float(parted.normal.sum())
        margin = 1.0 - load / (slip.friction * whole)
        observable = slip.deviation < settings.observed and margin < settings.observable_margin
        if observable:
            self._friction = slip.friction
        else:
            # Without slip, ratios hardly determine µ, and too large a µ would be unsafe.
            usual = min(slip.friction, self._friction)
            slip = Slip(friction=usual, deviation=max(slip.deviation, settings.unseen_error))
        points = lattice(self.dome).points
        excess = settings.misfit_error * max(found.misfit - 1.0, 0.0)
        narrow = math.hypot(settings.rim_error * parted.rim**2, excess)
        inwards = -(parted.displacement * points[found.nodes]).sum(axis=1) / self.dome.radius
        deep = settings.depth_error * max(float(inwards.max()), 0.0) / self.dome.thickness
        stiffened = settings.stiffening_error * parted.added
        normal_error = math.hypot(settings.normal_error, stiffened, deep, narrow)
        unsure = whole * np.array([normal_error, math.hypot(settings.friction_error, narrow)])
        slopes = _slopes(parted, net, points[found.nodes])
        spread = found.spread(slopes)
        covariance = spread @ spread.T
        totals = covariance[:2, :2] + np.diag(unsure**2)
        margin_deviation = _margin_deviation(slip, whole, load, totals, settings.margin_error)
        if self._silicone is not None:
            # Errors common to both sums and µ do not change Γ: treat them separately.
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
        """Covariance due to the uncertain calibration, see `UnsureSilicone`, shape (7, 7).

        Parameters
        ----------
        before: µ with which the forces were split
        slip: estimate of µ, or the assumed one if µ is not `observable`
        """
        assert self._fit is not None
        assert self._silicone is not None
        points = lattice(self.dome).points[found.nodes]

        def read(skin: Skin, linear: Array) -> Sums:
            other, mu = skin(found.nodes, linear, before), slip.friction
            if observable:
                load, both = float(np.linalg.norm(_across(other))), (other.normal, other.friction)
                slip_of = self._settings.slip
                mu = read_slip(self.dome, found.nodes, *both, load, other.rim, slip_of).friction
            return _sums(other, points, mu)

        sums = _sums(parted, points, slip.friction)
        return self._silicone(self._fit, self._response, found, sums, read)

    def _unsure_wrench(self, parted: Parted, unsure: float, narrow: float) -> Array:
        """Covariance of force and torque about z due to the unknown surface, shape (4, 4).

        Wrong normals change the size and the direction of the force that stiffening adds.
        """
        settings = self._settings
        out, whole = np.zeros((4, 4)), float(parted.normal.sum())
        tilted = whole * parted.added * math.hypot(settings.tilt_error, narrow)
        out[:3, :3] = unsure**2 * np.outer(parted.axis, parted.axis) + tilted**2 * np.eye(3)
        arm = self.dome.radius * math.hypot(settings.arm, settings.rim_arm * parted.rim**2)
        out[3, 3] = (arm * whole) ** 2
        return out


def _across(parted: Parted) -> Array:
    """Friction vector that counts in Γ [N], shape (3,), see `ForceField.net_friction`."""
    whole, axis = parted.friction.sum(axis=0), parted.axis
    return np.asarray(whole - axis * (whole @ axis))


def _sums(parted: Parted, points: Array, friction: float) -> Sums:
    """Sums of the forces on nodes with rest positions (n, 3), and Γ for a µ."""
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
    """Derivatives of ΣFn, ΣFf, Fx, Fy, Fz and Mz by the forces of the linear skin, (6, n, 3)."""
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


def _margin_deviation(slip: Slip, whole: float, load: float, totals: Array, least: float) -> float:
    """Standard deviation of Γ from those of µ and the sums; `least` is its lower bound."""
    share = load / (slip.friction * whole)
    slope = np.array([share / whole, -1.0 / (slip.friction * whole)])
    sums = math.sqrt(max(float(slope @ totals @ slope), 0.0))
    return math.hypot(share * slip.deviation, sums, least)


def _on_all(points: Array, found: Tractions, values: NDArray[np.generic]) -> NDArray:  # type: ignore[type-arg]
    """Expand values on the nodes in contact to all nodes, with zeros elsewhere."""
    out = np.zeros((len(points), *values.shape[1:]), values.dtype)
    out[found.nodes] = values
    return out
