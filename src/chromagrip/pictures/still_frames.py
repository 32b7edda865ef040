"""Frames of a sensor that holds still, judged: light, markers, motion in them and since rest."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import UserError
from ..output.processes import one_thread
from ..render import Frame, SensorDesign
from ..sensing.reader import Reader
from ..tracking import DEFAULT_TRACKER, Palette, load_tracker
from ..tracking.forces import rest_pose
from .noise_level import noise_level

Array = NDArray[np.float64]


def judge_rest(still: list[Frame], design: SensorDesign) -> tuple[Reader, float]:
    """Reader of the markers that frames of the unloaded sensor show, and their noise [grey levels].

    A load is noticed later, when the markers have moved once it is gone, see `judge_return`.

    Raises
    ------
    UserError
        When the frames show something else, or another sensor; with what to do about it.
    """
    _judge_light(still, design)
    noise, _ = noise_level(still, lossy=False)
    tracker = load_tracker(DEFAULT_TRACKER)(Palette.of_sensor(design), noise)
    with one_thread():
        rest = tracker.reset([replace(frame, time=0.0) for frame in still])
    rest_pose(design, rest)
    reader = Reader.of_tracker(tracker, DEFAULT_TRACKER, rest)
    _, moved = _motion(reader, still)
    if moved > least_motion(noise):
        raise UserError(f"the markers move by {moved:.2f} px between the frames: keep all still")
    return reader, noise


def judge_press(reader: Reader, noise: float, held: list[Frame]) -> None:
    """Refuse frames of a press that is not held, or hardly one.

    Parameters
    ----------
    reader, noise: of the frames of the unloaded sensor, see `judge_rest`
    held: frames of the press

    Raises
    ------
    UserError
        With what is wrong.
    """
    pressed, moved = _motion(reader, held)
    least, drift_share = least_motion(noise), 0.1  # share of the motion since rest
    if pressed < least:
        raise UserError(
            f"the markers have moved by {pressed:.2f} px since rest, a press moves them by "
            f"{least:.2f} px or more: press harder"
        )
    if moved > max(least, drift_share * pressed):
        raise UserError(
            f"the markers move by {moved:.2f} px in these frames, and by {pressed:.2f} px since "
            "rest: hold the press still"
        )


def judge_return(reader: Reader, noise: float, now: list[Frame]) -> None:
    """Refuse frames of a sensor that is not as it was at rest; parameters as of `judge_press`."""
    away, _ = _motion(reader, now)
    if away > least_motion(noise):
        raise UserError(
            f"the markers are {away:.2f} px from where they were at rest; if nothing touches the "
            "sensor, it has moved or was touched then: stop, and begin with another folder"
        )


def least_motion(noise: float) -> float:
    """Smallest motion that counts [px]; the noise [grey levels] looks like less."""
    least_px, px_per_level = 0.1, 0.03
    return max(least_px, px_per_level * noise)


def _motion(reader: Reader, frames: list[Frame]) -> tuple[float, float]:
    """How far the markers are from where they were at rest, and how far they move [px].

    Raises
    ------
    UserError
        When fewer than half of the markers are found.
    """
    rest, following = reader.rest, reader.copied()
    with one_thread():
        # The tracker needs a time between pictures.
        timed = (replace(frame, time=float(k)) for k, frame in enumerate(frames, 1))
        places = np.stack([following.track(frame).position for frame in timed])
    half = len(places) // 2
    begin, end = places[:half].mean(axis=0), places[half:].mean(axis=0)
    found, visible_share = np.isfinite(begin + end).all(axis=-1), 0.5
    if found.sum() < visible_share * rest.visible.sum():
        raise UserError("fewer than half of the markers are found: press with less force")

    def far(one: Array, other: Array) -> float:
        # A light press moves few markers.
        return float(np.nanquantile(np.linalg.norm(one - other, axis=-1), 0.99))

    return far(rest.position, 0.5 * (begin + end)), far(begin, end)


def _judge_light(still: list[Frame], design: SensorDesign) -> None:
    """Refuse frames that are too dark or too bright, or whose light changes."""
    image = still[0].image
    dark, most_clipped, most_change = 0.3 * max(design.ground.apex), 0.1, 0.02
    if (bright := float(np.quantile(image.max(axis=-1), 0.9))) < dark:
        raise UserError(
            f"the picture is too dark: nine tenths of it are below {bright:.0f} levels, wanted: "
            f"above {dark:.0f}; more light, or a longer exposure"
        )
    if (clipped := float((image >= 254).all(axis=-1).mean())) > most_clipped:
        raise UserError(
            f"the picture is overexposed: {clipped:.0%} of it are white, allowed: "
            f"{most_clipped:.0%}; shorten the exposure"
        )
    levels = np.array([frame.image.mean(axis=(0, 1)) for frame in still])
    if (change := float((np.ptp(levels, axis=0) / levels.mean(axis=0)).max())) > most_change:
        raise UserError(
            f"the light changes by {change:.1%} between the frames, allowed: {most_change:.0%}; "
            "fix exposure and white balance, and use light that does not flicker"
        )
