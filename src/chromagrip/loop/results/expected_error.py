"""Error of Γ to be expected of a sensor and its reader, from runs and limits measured before."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from statistics import median
from typing import Any, TypedDict

from ...output.cells import read_cells
from ...scene.scene import Body, Scene
from ..fidelity import TABLE, read

#: Smallest errors of Γ by design; `./run bench limits` of the checkout makes it.
LIMITS = Path(str(files(__package__) / "picture_limits.csv"))


@dataclass(frozen=True, kw_only=True)
class PictureLimit:
    """Smallest standard deviation of Γ that one picture of a design allows at Γ = 0.3.

    Attributes
    ----------
    body: body of the fingertip
    sensor: name of the design
    noise: by the noise of the camera alone
    with_misfit: with the misfit between real contacts and those that the reader fits
    """

    body: str
    sensor: str
    noise: float
    with_misfit: float


class ExpectedError(TypedDict):
    """Error of Γ to be expected, part of a summary.

    `typical` and `worst` are RMS errors of `situations` measured runs at `rate_hz`; None where
    this sensor and reader were not measured. Of one picture, `noise_allows` is the smallest error
    by the noise of the camera alone, and `picture_allows` that with the misfit between real
    contacts and those that the reader fits; None where they are unknown.
    """

    typical: float | None
    worst: float | None
    situations: int
    rate_hz: float | None
    noise_allows: float | None
    picture_allows: float | None


def expected_error(scene: Scene, reconstructor: str) -> ExpectedError:
    """Error of Γ to be expected of a scene that is read through its camera.

    Parameters
    ----------
    scene: scene with the names of its sensor and tracker
    reconstructor: name of the reconstructor in use
    """
    name = scene.sensor
    alike = [
        one
        for one in read(TABLE)
        if (one.sensor, one.fingers, one.scene_body) == (name, scene.fingers, scene.body)
        and (one.tracker, one.reconstructor) == (scene.tracker, reconstructor)
    ]
    errors = [one.seen for one in alike]
    body: Body = scene.body
    limits = {(one.body, one.sensor): one for one in read_cells(LIMITS, PictureLimit)}
    limit = limits.get((body, name))
    return {
        "typical": median(errors) if errors else None,
        "worst": max(errors) if errors else None,
        "situations": len(errors),
        "rate_hz": alike[0].rate_hz if alike else None,
        "noise_allows": None if limit is None else limit.noise,
        "picture_allows": None if limit is None else limit.with_misfit,
    }


def expected_words(expected: ExpectedError, summary: Mapping[str, Any]) -> str:
    """Describe it in words, with the reason, and with what is unlike in a run of that summary."""
    if expected["typical"] is None:
        return "not measured for this sensor and reader"
    words = (
        f"{expected['typical']:.3f} RMS in the median and {expected['worst']:.3f} at worst of "
        f"{expected['situations']} runs of margin-inversion measured at {expected['rate_hz']:g} Hz"
    )
    if summary.get("gross_slip") or summary.get("outcome") == "dropped":
        return f"{words} that held their object, which this one did not"
    noise, allowed = expected["noise_allows"], expected["picture_allows"]
    if noise is None or allowed is None:
        return words
    why = f"the camera's noise makes {noise:.3f}"
    if allowed > noise:
        unlike = math.sqrt(allowed**2 - noise**2)
        why += f", and contacts unlike those that the reader fits {unlike:.3f}"
    words += f". Why: in one picture alone {why}; a run averages over its pictures"
    return words + _larger(expected["worst"] or 0.0, summary)


def _larger(worst: float, summary: Mapping[str, Any]) -> str:
    """Why the error of a run is larger than that of every measured one; empty if it is not."""
    error, true, read = map(summary.get, ("margin_rmse", "final_mu_true", "final_mu_estimated"))
    if error is None or not error > worst:
        return ""
    words = f". This run's is {error:.3f}"
    if true is None or read is None or abs(read - true) < 0.05 * true:
        return words
    return (
        f"{words}: µ was read as {read:.2f}, but is {true:.2f}; pictures show it only once the "
        "contact is near slip"
    )
