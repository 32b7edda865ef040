"""Limits of a design on the node chain."""

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ...errors import UserError, located
from ...model import ContactObject, Fingertip
from ...render import Membrane, SensorDesign, areas, centroids, outlines, rest_membrane
from ...scene import load_scene
from .body import BodyLimit, Case
from .dials import STEPS
from .forces import Press, force_limit, pair_covariance, press

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ChainLimit(BodyLimit):
    """Limits of a design on the node chain.

    Attributes
    ----------
    fingertip, object_: in contact
    grip, load: forces of the object [N]
    """

    GRIP = 1.86
    LOAD = (0.65, 0.0)
    COLUMNS = (
        ("normal", "ΣFn mN", 1e3),
        ("friction", "ΣFf mN", 1e3),
        ("mu", "µ", 1.0),
        ("margin", "Γ", 1.0),
    )
    DIALS = ("markers", "height", "size", "noise")
    ERRORS = ("margin_error",)
    CURVES = (("margin_error", "standard deviation of Γ", 1.0),)
    NEAREST = False
    NEEDS = f", all else as in the design ({STEPS[0]:g} to {STEPS[-1]:g} times its own tried)"

    fingertip: Fingertip
    object_: ContactObject
    grip: float
    load: float

    def __post_init__(self) -> None:
        if self.design.shape.flat:
            raise UserError("a flat pad is not described by the node model")

    @staticmethod
    def default_designs() -> tuple[str, ...]:
        """The design of the thesis."""
        return ("thesis",)

    @classmethod
    def of(cls, case: Case, name: str) -> Self:
        """Load the scene of a case with a design."""
        changes = {
            "sensor": name,
            "object.friction": case.friction,
            "object.radius_mm": case.radius_mm,
            "object.stiffness_kpa": case.stiffness_kpa,
        }
        scene = load_scene("camera-100hz", changes)
        with located(f"sensor {name}"):
            return cls(
                design=scene.build_sensor(),
                levels=case.noise_levels,
                frames=case.frames,
                fingertip=scene.build_fingertip(),
                object_=scene.build_object(),
                grip=case.grip_n,
                load=case.load_n,
            )

    @cached_property
    def pressed(self) -> Press:
        """The contact."""
        return press(self.fingertip, self.object_, self.grip, self.load)

    def entry(self) -> dict[str, Any]:
        """Truth and limits."""
        field = self.pressed.field
        found = force_limit(self.design, self.pressed, self.levels, frames=self.frames)
        return {
            "normal_n": field.total_normal,
            "friction_n": field.total_friction,
            "margin": field.safety_margin(self.object_.friction),
            "limits": asdict(found),
        }

    @staticmethod
    def words(entry: dict[str, Any]) -> tuple[str, dict[str, dict[str, float | None]]]:
        """True Γ, and rows of any forces and of an object's contact."""
        limits = entry["limits"]
        smooth = {"normal": limits["any_normal"], "friction": limits["any_friction"]}
        rows = {"any smooth forces": smooth, "an object's contact": limits}
        return f"true Γ {entry['margin']:.3f}", rows

    def errors(self, design: SensorDesign, levels: float) -> dict[str, float]:
        """Error of Γ."""
        found = force_limit(design, self.pressed, levels, frames=self.frames)
        return {"margin_error": found.margin}

    def pair_errors(self) -> tuple[Array, dict[str, Array]]:
        """Standard deviations of a displacement of the skin, from one pair at rest."""
        sensor, nudge = self.design, 1e-6
        rest = rest_membrane(sensor)
        radial, azimuthal = rest.normals[0], sensor.shape.tangents(sensor.places)[1]
        columns = []
        for axis in (radial, np.cross(azimuthal, radial), azimuthal):
            shown = []
            for sign in (nudge, -nudge):
                shift = sign * sensor.follow[:, None, None] * axis
                image = outlines(
                    Membrane(centres=rest.centres + shift, axes=rest.axes), sensor.view
                )
                size = 0.5 * np.log(areas(image, square=False))
                both = np.concatenate([centroids(image, square=False), size[..., None]], axis=-1)
                shown.append(np.swapaxes(both, 0, 1).reshape(-1, 6))
            columns.append((shown[0] - shown[1]) / (2 * nudge))
        slope = np.stack(columns, axis=-1)
        covariance = self.levels**2 * pair_covariance(sensor, np.zeros((11, 2)))
        spread = np.linalg.inv(np.swapaxes(slope, -1, -2) @ np.linalg.inv(covariance) @ slope)
        deviation = np.sqrt(np.einsum("mii->im", spread))
        angle = np.rad2deg(sensor.places[:, 0])
        return angle, {"radially": deviation[0], "along the skin": deviation[1]}
