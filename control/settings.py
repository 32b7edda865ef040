"""Settings of the controllers, which are tables of a scene too: each key names its unit."""

from typing import Annotated

from msgspec import Meta

from ..strict_toml import NotNegative, Positive, Table

Share = Annotated[float, Meta(gt=0.0, lt=1.0)]
AtLeastOne = Annotated[float, Meta(ge=1.0, le=1e3)]


class GripFirstSettings(Table, frozen=True):
    """Settings of the least grip in doubt, a table within that of each controller that lowers it.

    Attributes
    ----------
    sliding_margin: lower end of the 90 % interval of Γ up to which a frame does not exclude sliding
    rise_n_per_s: rise of the grip force while no forces can be estimated, and at least this while
        frames do not exclude sliding [N/s]
    ceiling_n: highest grip force that doubt leads to [N]
    blind_s: time without an estimate for which the grip force is held before it rises [s]
    """

    sliding_margin: Share = 0.05
    rise_n_per_s: Positive = 3.0
    ceiling_n: Positive = 15.0
    blind_s: NotNegative = 0.03


class SafetyMarginSettings(Table, frozen=True):
    """Settings of Safety Margin Control, and the average of µ that every controller is given.

    The gains are those for a camera of 100 Hz with one frame of latency.

    Attributes
    ----------
    desired_margin: Γ_des
    feedforward_n: u [N]
    proportional_n: Kp [N]
    integral_n_per_s: Ki [N/s]
    friction_window_s: moving average of the estimate of µ [s]; used by the observers of all
        controllers
    floor_n: lowest grip force [N]
    start_s: time from which the controller is on [s]; before, it commands `feedforward_n`
    grip_first: least grip in doubt
    """

    desired_margin: Share = 0.30
    feedforward_n: Positive = 0.5
    proportional_n: NotNegative = 0.25
    integral_n_per_s: NotNegative = 30.0
    friction_window_s: Positive = 0.3
    floor_n: Positive = 0.1
    start_s: NotNegative = 0.04
    grip_first: GripFirstSettings = GripFirstSettings()


class MarginInversionSettings(Table, frozen=True):
    """Settings of Margin Inversion.

    Attributes
    ----------
    desired_margin: Γ_des
    start_n: grip force until µ is observable [N]
    floor_n, ceiling_n: lowest and highest grip force [N]
    release_n_per_s: fastest decrease of the grip force [N/s]; it may rise at once
    caution: the µ that is used is this many standard deviations below the estimate
    tolerance: the µ that is used may be this many standard deviations above the estimate, each of
        at least a tenth of µ
    slip_margin: estimated Γ below which the skin slips, so that the estimate of µ is exact
    surge: largest factor on the grip force while the skin slips: the load is more than the friction
    smoothing_s: time constant of small changes [s]
    band: share of the grip force up to which a change is small
    grip_first: least grip in doubt
    """

    desired_margin: Share = 0.30
    start_n: Positive = 1.0
    floor_n: Positive = 0.1
    ceiling_n: Positive = 15.0
    release_n_per_s: Positive = 3.0
    caution: NotNegative = 1.0
    tolerance: NotNegative = 1.0
    slip_margin: Share = 0.1
    surge: AtLeastOne = 1.5
    smoothing_s: Positive = 0.1
    band: Share = 0.05
    grip_first: GripFirstSettings = GripFirstSettings()


class LimitSurfaceSettings(MarginInversionSettings, frozen=True):
    """Settings of Limit Surface: those of Margin Inversion, and how far it looks ahead.

    Attributes
    ----------
    lead_s: while the torsion rises, it is extrapolated by so long [s]
    rise_s: time over which its rise is measured [s]
    """

    lead_s: NotNegative = 0.15
    rise_s: Positive = 0.03


class ReactToSlipSettings(Table, frozen=True):
    """Settings of React To Slip (thesis section 4.2, E12).

    Attributes
    ----------
    start_n: grip force until slip [N]
    step_n: added at each slip event [N]
    displacement_mm: lateral displacement that is a slip event, where it is known [mm]
    margin: estimated Γ that is a slip event, where the displacement is unknown …
    hold_s: … once the mean of Γ over this time is below it [s]; doubt must last as long
    grip_first: least grip in doubt
    """

    start_n: Positive = 0.5
    step_n: Positive = 2.0
    displacement_mm: Positive = 1.3
    margin: Share = 0.05
    hold_s: NotNegative = 0.1
    grip_first: GripFirstSettings = GripFirstSettings()


class ConservativeSettings(Table, frozen=True):
    """Settings of Conservative Control (thesis Eq. 10).

    Attributes
    ----------
    force_n: constant grip force [N]
    """

    force_n: Positive = 5.0


#: Settings of Safety Margin Control as printed, for 1 kHz without latency (thesis section 4.1, E1).
#: The printed Ki of 0.1 for each sample of 1 ms is 100 per second (E2).
PRINTED_SETTINGS = SafetyMarginSettings(
    proportional_n=2.5, integral_n_per_s=100.0, friction_window_s=0.05
)
