"""Parameters that the thesis does not print, and the values at which their effect is measured."""

from dataclasses import dataclass, field

from ...model import ContactObject

_DEFAULT = ContactObject()
#: Unprinted parameters that every figure here uses.
UNPRINTED = (
    f"Dahl n = {_DEFAULT.dahl_exponent:g}, σ0 = {_DEFAULT.dahl_stiffness:g} N/m per node, "
    f"drag {_DEFAULT.drag:g} N·s/m"
)


@dataclass(frozen=True)
class Variant:
    """One unprinted parameter at another value.

    Attributes
    ----------
    text: parameter and value
    changes: of the scene
    radii: of round objects, in place of the inferred ones [mm]
    """

    text: str
    changes: dict[str, float] = field(default_factory=dict)
    radii: dict[float, float] = field(default_factory=dict)


#: The values that are used everywhere else here.
PLAIN = Variant("as everywhere here")
#: Friction and drag of the object, one changed at a time.
SWEEP = [
    Variant("Dahl exponent 1", {"object.dahl_exponent": 1.0}),
    Variant("Dahl exponent 0.5", {"object.dahl_exponent": 0.5}),
    Variant("σ0 1000 N/m", {"object.dahl_stiffness_n_per_m": 1000.0}),
    Variant("σ0 20000 N/m", {"object.dahl_stiffness_n_per_m": 20000.0}),
    Variant("drag 25 N·s/m", {"object.drag_n_s_per_m": 25.0}),
    Variant("drag 60 N·s/m", {"object.drag_n_s_per_m": 60.0}),
    Variant("drag 240 N·s/m", {"object.drag_n_s_per_m": 240.0}),
]
#: The radius of the sharpest objects is inferred too (E5); it matters to Table 2 only.
BLUNTER = Variant("radii flat, 20 and 10 mm", radii={5.0: 10.0})
