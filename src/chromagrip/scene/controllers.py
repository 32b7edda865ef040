"""Controllers by name, with their tables in a scene; and anybody's by `module:Class`."""

from typing import Annotated

from msgspec import Meta

from ..by_name import Registry
from ..control import (
    ConservativeControl,
    ConservativeSettings,
    Controller,
    MarginInversion,
    MarginInversionSettings,
    ReactToSlip,
    ReactToSlipSettings,
    SafetyMarginControl,
    SafetyMarginGains,
)
from ..strict_toml import Table

Positive = Annotated[float, Meta(gt=0.0, le=1e9)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e9)]
Share = Annotated[float, Meta(gt=0.0, lt=1.0)]
AtLeastOne = Annotated[float, Meta(ge=1.0, le=1e3)]

#: Controllers by name; the table of one of ours in a scene has the same name.
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
            "the grip at which the load read off the image has the desired margin",
        ),
        "react-to-slip": (
            "..control:ReactToSlip",
            "constant force, raised by a step each time slip is seen",
        ),
        "conservative": ("..control:ConservativeControl", "constant force, more than is needed"),
    },
)


class SafetyMarginSettings(Table, frozen=True):
    """Safety Margin Control, and the average of µ that every controller is told."""

    desired_margin: Share = 0.30
    feedforward_n: Positive = 0.5
    proportional_n: NotNegative = 0.25
    integral_n_per_s: NotNegative = 30.0
    friction_window_s: Positive = 0.3
    floor_n: Positive = 0.1
    start_s: NotNegative = 0.04

    def build(self) -> Controller:
        """The controller."""
        return SafetyMarginControl(
            SafetyMarginGains(
                desired_margin=self.desired_margin,
                feedforward=self.feedforward_n,
                proportional=self.proportional_n,
                integral=self.integral_n_per_s,
                floor=self.floor_n,
                start=self.start_s,
            )
        )


class MarginInversionTable(Table, frozen=True):
    """Margin Inversion; see `MarginInversionSettings`."""

    desired_margin: Share = 0.30
    start_n: Positive = 1.0
    floor_n: Positive = 0.1
    ceiling_n: Positive = 15.0
    release_n_per_s: Positive = 3.0
    caution: NotNegative = 0.25
    tolerance: NotNegative = 1.0
    slip_margin: Share = 0.1
    surge: AtLeastOne = 1.5
    smoothing_s: Positive = 0.1
    band: Share = 0.05

    def build(self) -> Controller:
        """The controller."""
        return MarginInversion(
            MarginInversionSettings(
                desired_margin=self.desired_margin,
                start=self.start_n,
                floor=self.floor_n,
                ceiling=self.ceiling_n,
                release=self.release_n_per_s,
                caution=self.caution,
                tolerance=self.tolerance,
                slip_margin=self.slip_margin,
                surge=self.surge,
                smoothing=self.smoothing_s,
                band=self.band,
            )
        )


class ReactToSlipTable(Table, frozen=True):
    """React To Slip."""

    start_n: Positive = 0.5
    step_n: Positive = 2.0
    displacement_mm: Positive = 1.3
    margin: Share = 0.05
    hold_s: NotNegative = 0.1

    def build(self) -> Controller:
        """The controller."""
        return ReactToSlip(
            ReactToSlipSettings(
                start_force=self.start_n,
                step_force=self.step_n,
                displacement=self.displacement_mm * 1e-3,
                margin=self.margin,
                hold=self.hold_s,
            )
        )


class ConservativeTable(Table, frozen=True):
    """Conservative Control."""

    force_n: Positive = 5.0

    def build(self) -> Controller:
        """The controller."""
        return ConservativeControl(ConservativeSettings(force=self.force_n))
