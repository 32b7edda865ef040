"""Controllers by name; the settings of each of ours are the table of that name in a scene."""

from typing import TYPE_CHECKING

from ..by_name import Registry
from ..control import Controller

if TYPE_CHECKING:
    from .scene import Scene

CONTROLLERS = Registry(
    protocol=Controller,
    package=__package__,
    entries={
        "safety-margin": (
            "..control:SafetyMarginControl",
            "PI control of the safety margin around its desired value",
        ),
        "margin-inversion": (
            "..control:MarginInversion",
            "the grip force at which the estimated load has the desired margin",
        ),
        "limit-surface": (
            "..control:LimitSurfaceControl",
            "the grip at which friction and torsion together have the desired margin, with a lead",
        ),
        "react-to-slip": (
            "..control:ReactToSlip",
            "constant force, raised by a step at each slip event",
        ),
        "conservative": ("..control:ConservativeControl", "constant force, more than is needed"),
    },
)


def target_margin(scene: "Scene") -> float | None:
    """Safety margin that the scene's controller aims at; None where it has no such setting."""
    settings = getattr(scene, scene.controller.replace("-", "_"), None)
    target: float | None = getattr(settings, "desired_margin", None)
    return target
