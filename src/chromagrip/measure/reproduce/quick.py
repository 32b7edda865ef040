"""What a quick run leaves out of the 27 objects of Fig. 16 and Table 2."""

from collections.abc import Sequence

import numpy as np

from ...thesis import FRICTIONS, OBJECTS, RADII_MM, STIFFNESSES_KPA

#: Friction coefficient, stiffness [kPa] and radius [mm].
Object = tuple[float, float, float]

#: The objects that go through the camera in a quick run: each value of each property once.
QUICK_OBJECTS = tuple(zip(FRICTIONS, STIFFNESSES_KPA, RADII_MM, strict=True))


def seen_objects(quick: bool) -> Sequence[Object]:
    """Objects that go through the camera."""
    return QUICK_OBJECTS if quick else OBJECTS


def left_out(camera: str | None) -> str:
    """What a quick run leaves out of the 27 objects, in a sentence."""
    text = "A quick run: no objects whose surfaces travel"
    if camera is None:
        return f"{text}."
    some = "; ".join(
        f"µ {mu:g}, {kpa:g} kPa, {'flat' if np.isinf(radius) else f'{radius:g} mm'}"
        for mu, kpa, radius in QUICK_OBJECTS
    )
    return (
        f"{text}, and {len(QUICK_OBJECTS)} of the {len(OBJECTS)} objects through the camera "
        f"({some}), compared with the same ones on the truth path; the others are left out."
    )
