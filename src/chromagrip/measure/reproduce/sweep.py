"""What the thesis does not print, turned one at a time, to see what moves what."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Variant:
    """One unprinted parameter at another value.

    Attributes
    ----------
    text: what is turned
    changes: of the scene
    radii: of round objects, instead of those inferred [mm]
    """

    text: str
    changes: dict[str, float] = field(default_factory=dict)
    radii: dict[float, float] = field(default_factory=dict)


PLAIN = Variant("as everywhere here")
#: Of the object's friction and drag; the widths of a pressure come from the same runs.
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
