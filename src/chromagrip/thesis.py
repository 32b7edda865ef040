"""Conditions of the thesis's experiments, which scenes, benches and charts repeat.

Each value names the section of the thesis that it was read from.
"""

import math
from itertools import product
from typing import NamedTuple

#: Lateral loads on the object, each held until the next one [N] (section 6.1, Fig. 14).
LOADS_N = (0.25, 0.65)
#: Times from which the loads act [s] (section 6.1). Controllers are switched on at the first one.
LOAD_TIMES_S = (0.04, 1.0)
#: Length of the validation run [s] (section 6.1, Figs. 13 to 15).
DURATION_S = 2.0
#: Margin Γ that Safety Margin Control is to keep (section 4.1).
DESIRED_MARGIN = 0.30

#: Friction coefficients µ of the objects (section 5.2).
FRICTIONS = (0.3, 0.5, 0.7)
#: Young's moduli of the objects [kPa] (section 5.2).
STIFFNESSES_KPA = (200.0, 32.0, 16.0)
#: Radii of the objects [mm]. Section 5.2 prints "0 to 20 mm"; 20 and 5 mm beside a flat object are
#: inferred from the pressures of Table 2.
RADII_MM = (math.inf, 20.0, 5.0)


class ThesisObject(NamedTuple):
    """One of the objects.

    Attributes
    ----------
    friction: coefficient µ
    stiffness_kpa: Young's modulus [kPa]
    radius_mm: of its surface [mm]; inf is flat
    """

    friction: float
    stiffness_kpa: float
    radius_mm: float


#: The 27 objects of Fig. 16 and Table 2 (section 5.2).
OBJECTS = [ThesisObject(*values) for values in product(FRICTIONS, STIFFNESSES_KPA, RADII_MM)]
