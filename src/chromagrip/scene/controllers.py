"""Controllers by name; each of ours is set by the scene's table of that name."""

from ..by_name import Registry
from ..control import Controller

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
