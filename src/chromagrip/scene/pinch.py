"""Table of a scene with two fingers: the object that they hold, and the path of the hand."""

import math
from dataclasses import replace
from typing import Annotated

import numpy as np
from msgspec import Meta

from ..errors import UserError
from ..model import SoftBody, Solid
from ..model.pinch import Filling, HandPath, Limits, Pinch, Shake, box_body
from ..strict_toml import NotNegative, Positive, Table
from .settings import ObjectSettings

Way = Annotated[float, Meta(ge=-1e4, le=1e4)]
Turn = Annotated[float, Meta(ge=-360.0, le=360.0)]
Vector = tuple[Way, Way, Way]


class PinchSettings(Table, frozen=True):
    """Two fingers that hold one object with a weight; x is down, z from the first to the second.

    Attributes
    ----------
    mass_g: mass of the object [g]; above 0
    centre_mm: centre of mass in the object's own frame [mm]
    inertia_g_mm2: moments of inertia about the centre of mass, along the object's axes [g·mm²];
        empty: those of a homogeneous box as large as the object
    fill_times_s: knots of the mass added to the object [s]; empty: no mass is added
    fill_g: mass added up to each knot [g]
    second_sensor: design of the second finger; empty: that of the first
    hand_times_s: knots of the hand's path [s]; empty: the hand stays in place
    hand_mm: place of the hand at each knot [mm]
    hand_turns_deg: rotation vector of the hand at each knot [°]; empty: it does not turn
    shake_mm, shake_hz: amplitude [mm] and frequency [Hz] of a sine added to the hand's place
    shake_s: start and end of that sine [s]; empty: no sine
    table: whether the object stands on a table until it is lifted
    closing_n_s_per_m: damper of each finger's motion as the drive closes it [N·s/m]
    dropped_mm: slide in the hand at which the object counts as dropped [mm]
    turned_deg: turn about z, without the elastic twist, at which it counts as turned [°]
    crushed_kpa: mean contact pressure at which it counts as crushed [kPa]; 0: never
    """

    mass_g: NotNegative = 0.0
    centre_mm: Vector = (0.0, 0.0, 0.0)
    inertia_g_mm2: tuple[Positive, ...] = ()
    fill_times_s: tuple[NotNegative, ...] = ()
    fill_g: tuple[NotNegative, ...] = ()
    second_sensor: str = ""
    hand_times_s: tuple[NotNegative, ...] = ()
    hand_mm: tuple[Vector, ...] = ()
    hand_turns_deg: tuple[tuple[Turn, Turn, Turn], ...] = ()
    shake_mm: Vector = (0.0, 0.0, 0.0)
    shake_hz: Positive = 1.0
    shake_s: tuple[NotNegative, ...] = ()
    table: bool = True
    closing_n_s_per_m: Positive = 25.2
    dropped_mm: Positive = 5.0
    turned_deg: Positive = 20.0
    crushed_kpa: NotNegative = 0.0

    def __post_init__(self) -> None:
        for name, values in (("hand_mm", self.hand_mm), ("hand_turns_deg", self.hand_turns_deg)):
            if len(values) != len(self.hand_times_s) and (values or name == "hand_mm"):
                raise UserError(
                    f"hand_times_s has {len(self.hand_times_s)} entries and {name} {len(values)}; "
                    "both need the same number"
                )
        if len(self.inertia_g_mm2) not in (0, 3):
            raise UserError(f"inertia_g_mm2 must be three numbers, got {list(self.inertia_g_mm2)}")
        if len(self.shake_s) not in (0, 2):
            raise UserError(f"shake_s must be a start and an end, got {list(self.shake_s)}")
        if len(self.fill_times_s) != len(self.fill_g):
            raise UserError(
                f"fill_times_s has {len(self.fill_times_s)} entries and fill_g {len(self.fill_g)}; "
                "both need the same number"
            )
        self.build_hand()
        self.build_filling()

    @property
    def limits(self) -> Limits:
        """Limits at which the object counts as dropped, turned or crushed."""
        return Limits(
            slide=1e-3 * self.dropped_mm,
            turn=math.radians(self.turned_deg),
            pressure=1e3 * self.crushed_kpa if self.crushed_kpa else math.inf,
        )

    @property
    def lifts_at(self) -> float:
        """Time at which the hand begins to move [s]; 0 if it never moves."""
        moves = [a != b for a, b in zip(self.hand_mm[:-1], self.hand_mm[1:], strict=True)]
        return self.hand_times_s[moves.index(True)] if True in moves else 0.0

    def build_hand(self) -> HandPath:
        """Build the path of the hand.

        Raises
        ------
        UserError
            For times that do not increase from 0, and for a shake that is too short.
        """
        shake = None
        if self.shake_s:
            x, y, z = (1e-3 * way for way in self.shake_mm)
            start, stop = self.shake_s
            shake = Shake(amplitude=(x, y, z), frequency=self.shake_hz, start=start, stop=stop)
        if not self.hand_times_s:
            return HandPath(shake=shake)
        return HandPath(
            times=self.hand_times_s,
            places=tuple((1e-3 * x, 1e-3 * y, 1e-3 * z) for x, y, z in self.hand_mm),
            turns=tuple(
                (math.radians(a), math.radians(b), math.radians(c))
                for a, b, c in self.hand_turns_deg
            ),
            shake=shake,
        )

    def build_filling(self) -> Filling | None:
        """Build the mass added to the object over time; None if no mass is added.

        Raises
        ------
        UserError
            For times that do not increase.
        """
        if not self.fill_times_s:
            return None
        return Filling(times=self.fill_times_s, masses=tuple(1e-3 * each for each in self.fill_g))

    def build(self, first: SoftBody, second: SoftBody, solid: Solid, held: ObjectSettings) -> Pinch:
        """Build the pinch: both fingertips and the object between them.

        Raises
        ------
        UserError
            For an object of infinite size.
        """
        if not np.isfinite(solid.shape.bounds).all():
            raise UserError(
                f"pinch: two fingers hold an object of finite size, not a {solid.shape.name}; set "
                "object.shape or object.radius_mm"
            )
        x, y, z = np.ptp(solid.shape.bounds, axis=0).tolist()
        cx, cy, cz = (1e-3 * way for way in self.centre_mm)
        body = box_body(1e-3 * self.mass_g, (x, y, z), (cx, cy, cz))
        if self.inertia_g_mm2:
            a, b, c = (1e-9 * value for value in self.inertia_g_mm2)
            body = replace(body, inertia=(a, b, c))
        tx, ty, tz = (math.radians(angle) for angle in held.turned_deg)
        bx, by = (1e-3 * way for way in held.beside_mm)
        return Pinch(
            first=first,
            second=second,
            solid=solid,
            body=body,
            hand=self.build_hand(),
            filling=self.build_filling(),
            turned=(tx, ty, tz),
            beside=(bx, by),
            drag=self.closing_n_s_per_m,
            table=self.table,
        )
