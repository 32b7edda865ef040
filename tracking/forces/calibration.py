"""Calibration of a sensor, all that an estimator may know besides the rest frame, and its file."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta
from msgspec.structs import replace as changed

from ...errors import UserError, located, meant
from ...model import REFERENCE_NODES, Fingertip, SpringLaw
from ...render import SensorDesign, load_sensor, sensor_names
from ...strict_toml import Table, convert, read_toml
from .displacement import DisplacementGains
from .kept_readouts import kept_readout
from .silicone_values import SiliconeValues, yellow_moves

FORMAT: Literal["chromagrip calibration 1"] = "chromagrip calibration 1"

#: Folder of the shipped read-outs (trained networks that estimate forces).
SHIPPED = Path(__file__).parents[1] / "readouts"

Positive = Annotated[float, Meta(gt=0.0, le=1e6)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e6)]


class Values(Table, frozen=True, kw_only=True):
    """Parameters of a sensor that is read as a chain; per-node stiffnesses at 251 nodes."""

    tissue_stiffness_n_per_m: Positive
    membrane_stiffness_n_per_m: Positive
    tissue_poisson: Annotated[float, Meta(ge=0.0, le=0.5)]
    yellow_follow: Annotated[float, Meta(ge=0.0, le=1.0)]
    magenta_depth_mm: NotNegative
    yellow_depth_mm: NotNegative


class FitReport(Table, frozen=True, kw_only=True):
    """Presses to which the parameters were fitted, and the remaining errors.

    `normal_error_share` is the RMS error of the presses' normal forces, as fitted, and `error_px`
    that of marker positions. Earlier files of chains have `friction_error_n`.
    `covariance` belongs to the parameters in `deviations`, in their order. `undetermined` names
    those that stay as designed, with the standard deviation of the prior.
    """

    presses: tuple[str, ...]
    noise_levels: NotNegative
    error_px: NotNegative
    normal_error_share: NotNegative | None = None
    friction_error_n: NotNegative | None = None
    deviations: dict[str, float] = {}  # noqa: RUF012 (msgspec copies it)
    covariance: tuple[tuple[float, ...], ...] = ()
    undetermined: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class SensorCalibration:
    """Calibration of one sensor: its image, its mechanics, and the errors of both.

    Attributes
    ----------
    sensor: calibrated design, for the image
    fingertip: calibrated chain, for the mechanics; unused for a flat pad, which has no force model
    position_floor: model error of a marker's motion, added to its noise [px]
    size_floor: model error of a marker's logarithmic size
    stiffness_deviation: relative standard deviation of a common error of all stiffnesses, which is
        also that of ΣFn and ΣFf
    readout: file of the trained read-out for this kind of sensor; None without one
    name: name of the sensor or of the calibration's file, for messages
    displacement: gains from image to displacement; None if not calibrated
    design: design before the calibration; None if `sensor` is as designed
    """

    sensor: SensorDesign
    fingertip: Fingertip
    position_floor: float = 0.01
    size_floor: float = 6e-4
    stiffness_deviation: float = 0.0
    readout: Path | None = None
    name: str = field(default="", compare=False)
    displacement: DisplacementGains | None = None
    design: SensorDesign | None = field(default=None, compare=False)

    @property
    def nominal(self) -> SensorDesign:
        """The sensor as designed."""
        return self.sensor if self.design is None else self.design


class _File(Table, frozen=True, kw_only=True):
    """Contents of a calibration file."""

    format: Literal["chromagrip calibration 1"]
    sensor: str
    readout: str = ""
    position_floor_px: NotNegative = SensorCalibration.position_floor
    size_floor: NotNegative = SensorCalibration.size_floor
    stiffness_deviation: Annotated[float, Meta(ge=0.0, le=1.0)] | None = None
    values: Values | None = None
    silicone: SiliconeValues | None = None
    displacement: DisplacementGains | None = None
    fit: FitReport | None = None


def nominal_calibration(sensor: SensorDesign, law: SpringLaw = "split") -> SensorCalibration:
    """Calibration of a sensor as designed, with the thesis's materials.

    The uncertainty of its stiffness is the spread of specimens that the design states.
    """
    tip = Fingertip.of_radius(sensor.shape.radius, nodes=REFERENCE_NODES, law=law)
    deviation = sensor.stiffness_deviation
    return SensorCalibration(sensor=sensor, fingertip=tip, stiffness_deviation=deviation)


def sensor_as_designed(name: str, law: SpringLaw = "split") -> SensorCalibration:
    """Nominal calibration of a shipped design or of a design file, with its read-out if any.

    Parameters
    ----------
    name: name of the design, or its file
    law: spring law of the fingertip; read-outs need `split`

    Raises
    ------
    UserError
        When there is no such design.
    """
    sensor = load_sensor(name)
    readout = (shipped_readout(name) or kept_readout(sensor)) if law == "split" else None
    return replace(nominal_calibration(sensor, law), name=name, readout=readout)


def with_values(calibration: SensorCalibration, values: Values) -> SensorCalibration:
    """Copy a calibration with other parameters.

    Raises
    ------
    UserError
        When a layer is deeper than the silicone.
    """
    sensor = calibration.sensor
    return replace(
        calibration,
        design=calibration.nominal,
        sensor=changed(
            sensor,
            magenta=changed(sensor.magenta, depth_mm=values.magenta_depth_mm),
            yellow=changed(
                sensor.inner, depth_mm=values.yellow_depth_mm, follow=values.yellow_follow
            ),
        ),
        fingertip=replace(
            calibration.fingertip,
            tissue_stiffness=values.tissue_stiffness_n_per_m,
            membrane_stiffness=values.membrane_stiffness_n_per_m,
            poisson_tissue=values.tissue_poisson,
        ),
    )


def silicone_of(calibration: SensorCalibration) -> SiliconeValues | None:
    """Parameters of a dome's silicone that can be fitted to presses; None without silicone."""
    sensor = calibration.sensor
    if sensor.silicone is None or sensor.shape.flat:
        return None
    return SiliconeValues(
        core_mm=sensor.silicone.core_mm,
        young_kpa=sensor.silicone.young_kpa,
        poisson=sensor.silicone.poisson,
        magenta_depth_mm=sensor.magenta.depth_mm,
        yellow_depth_mm=sensor.inner.depth_mm if yellow_moves(sensor) else None,
    )


def with_silicone(calibration: SensorCalibration, values: SiliconeValues) -> SensorCalibration:
    """Copy a calibration with other silicone, see `SiliconeValues`.

    Raises
    ------
    UserError
        When the design has no silicone, or the values make no dome.
    """
    sensor = calibration.sensor
    if sensor.silicone is None or sensor.shape.flat:
        raise UserError("[silicone] is of a design with a dome of silicone; this one has none")
    yellow = values.yellow_depth_mm
    if yellow is None:
        yellow = sensor.inner.depth_mm - (values.core_mm - sensor.silicone.core_mm)
    if not yellow >= 0.0:
        raise UserError(
            f"silicone.core_mm = {values.core_mm:g} puts the yellow layer above the skin; allowed: "
            f"up to {sensor.silicone.core_mm + sensor.inner.depth_mm:g}"
        )
    return replace(
        calibration,
        design=calibration.nominal,
        sensor=changed(
            sensor,
            magenta=changed(sensor.magenta, depth_mm=values.magenta_depth_mm),
            yellow=changed(sensor.inner, depth_mm=yellow),
            silicone=changed(
                sensor.silicone,
                core_mm=values.core_mm,
                young_kpa=values.young_kpa,
                poisson=values.poisson,
            ),
        ),
    )


def check_stiff(sensor: SensorDesign) -> None:
    """Refuse markers whose deformation under a force has no formula.

    Raises
    ------
    UserError
        When they are not stiff discs.
    """
    markers = sensor.markers
    if markers.stretch or markers.swell_mm or markers.form != "disc":
        raise UserError(
            "this reads forces from stiff discs only: markers.form = 'disc', markers.stretch = 0 "
            "and markers.swell_mm = 0; a trained read-out reads other discs too"
        )


def load_calibration(name: str) -> SensorCalibration:
    """Load a calibration file, or the nominal calibration of a shipped sensor or a design file.

    A path of a design in the file is relative to the file. The read-out is the one that the file
    names, else the shipped one of the design, else the one in the user's cache.

    Raises
    ------
    UserError
        When there is no such calibration, or it has a key or value that is not allowed.
    """
    if name in sensor_names():
        return sensor_as_designed(name)
    if not name.endswith(".toml"):
        raise UserError(
            f"no calibration {name!r}{meant(name, sensor_names())}; give a .toml file of "
            "`chromagrip calibrate sensor`, or for a sensor as designed its .toml file or one of "
            f"{', '.join(sensor_names())}"
        )
    folder, title = Path(name).parent, f"calibration {name}"
    values = read_toml(Path(name), title)
    if "format" not in values and "skin" in values:  # a design
        return sensor_as_designed(name)
    found = values.get("format")
    if found is None:
        raise UserError(f"{title} is no file of `chromagrip calibrate sensor`: it has no format")
    if found != FORMAT:
        raise UserError(f"{title} has format {found!r}; wanted: {FORMAT!r}")
    file = convert(values, _File, title)
    own = file.sensor.endswith(".toml")
    calibration = sensor_as_designed(str(folder / file.sensor) if own else file.sensor)
    if file.values is not None:
        calibration = with_values(calibration, file.values)
    if file.silicone is not None:
        with located(title):
            calibration = with_silicone(calibration, file.silicone)
    return replace(
        calibration,
        name=name,
        position_floor=file.position_floor_px,
        size_floor=file.size_floor,
        stiffness_deviation=(
            calibration.stiffness_deviation
            if file.stiffness_deviation is None
            else file.stiffness_deviation
        ),
        readout=folder / file.readout if file.readout else calibration.readout,
        displacement=file.displacement,
    )


def check_trainable(calibration: SensorCalibration) -> None:
    """Refuse a sensor for which no read-out can be trained.

    Raises
    ------
    UserError
        When it is a flat pad, its markers are not discs, or its fingertip has another spring law.
    """
    with located(f"sensor {calibration.name}".rstrip()):
        if calibration.sensor.shape.flat:
            raise UserError(
                "a flat pad has no force model: calibrate its displacements with `chromagrip "
                "calibrate sensor`"
            )
        if calibration.sensor.markers.form != "disc":
            raise UserError("forces are read from discs only: markers.form = 'disc'")
        law = calibration.fingertip.law
        if law != "split":
            raise UserError(
                f"read-outs are trained with the spring law split, the fingertip has {law}: "
                "choose fingertip.model = 'split'"
            )


def required_readout(calibration: SensorCalibration) -> Path:
    """File of the sensor's trained read-out.

    Raises
    ------
    UserError
        When it has none, or none can be trained.
    """
    if calibration.readout is not None:
        return calibration.readout
    check_trainable(calibration)
    raise UserError(
        f"{f'sensor {calibration.name}'.rstrip()} has no trained read-out: train one with "
        f"`chromagrip calibrate readout {calibration.name or 'SENSOR'}`, which takes minutes"
    )


def shipped_readout(sensor: str) -> Path | None:
    """Read-out trained for a shipped design, if there is one."""
    if sensor not in sensor_names():
        return None
    path = SHIPPED / f"{sensor}.npz"
    return path if path.exists() else None


def calibration_table(
    calibration: SensorCalibration, sensor: str, report: FitReport
) -> dict[str, object]:
    """Make the contents of a calibration file.

    Parameters
    ----------
    calibration: calibration to write
    sensor: name or file of the design before the calibration
    report: report of the fit
    """
    pressed = calibration.sensor.silicone != calibration.nominal.silicone
    file = _File(
        format=FORMAT,
        sensor=sensor,
        position_floor_px=calibration.position_floor,
        size_floor=calibration.size_floor,
        stiffness_deviation=calibration.stiffness_deviation,
        silicone=silicone_of(calibration) if pressed else None,
        displacement=calibration.displacement,
        fit=report,
    )
    return _without_none(msgspec.to_builtins(file))


def _without_none(table: dict[str, object]) -> dict[str, object]:
    """Remove keys whose value is None, as TOML has no null."""
    return {
        key: _without_none(value) if isinstance(value, dict) else value
        for key, value in table.items()
        if value is not None
    }
