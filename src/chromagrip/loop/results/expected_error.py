"""Error of Γ to expect of a sensor and its reader: runs of `./run bench fidelity`, as shipped."""

from collections.abc import Mapping
from statistics import median
from typing import Any, TypedDict

from ...scene.scene import Scene
from ..fidelity import TABLE, read


class ExpectedError(TypedDict):
    """RMS errors of Γ in `situations` measured runs at `rate_hz`; None if none were measured."""

    typical: float | None
    worst: float | None
    situations: int
    rate_hz: float | None


def expected_error(scene: Scene, reconstructor: str) -> ExpectedError:
    """Error of Γ to expect of a scene that is read through its camera.

    Parameters
    ----------
    scene: scene with the names of its sensor and tracker
    reconstructor: name of the reconstructor in use
    """
    wanted = (scene.sensor, scene.fingers, scene.body, scene.tracker, reconstructor)
    alike = [
        one
        for one in read(TABLE)
        if (one.sensor, one.fingers, one.scene_body, one.tracker, one.reconstructor) == wanted
    ]
    errors = [one.seen for one in alike]
    return {
        "typical": median(errors) if errors else None,
        "worst": max(errors) if errors else None,
        "situations": len(errors),
        "rate_hz": alike[0].rate_hz if alike else None,
    }


def expected_words(expected: ExpectedError, summary: Mapping[str, Any]) -> str:
    """Describe it in words, with what is unlike in a run of that summary."""
    if expected["typical"] is None:
        return "not measured for this sensor and reader"
    words = (
        f"{expected['typical']:.3f} RMS in the median and {expected['worst']:.3f} at worst of "
        f"{expected['situations']} runs of margin-inversion measured at {expected['rate_hz']:g} Hz"
    )
    if summary.get("gross_slip") or summary.get("outcome") == "dropped":
        return f"{words} that held their object, which this one did not"
    error = summary.get("margin_rmse")
    if error is not None and error > (expected["worst"] or 0.0):
        words += f". This run's is {error:.3f}"
    return words
