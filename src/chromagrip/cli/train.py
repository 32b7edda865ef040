"""The command `train`: a read-out of forces and friction for one kind of sensor."""

import json
import os
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from ..errors import UserError, located
from ..extras import require
from .options import Flag, option, telling


def train(
    calibration: Annotated[
        str,
        tyro.conf.Positional,
        option("sensor as designed, or the .toml file of its calibration", "SENSOR|FILE.toml"),
    ],
    *,
    out: Annotated[Path, option("file of the read-out", "FILE.npz")],
    noise: Annotated[float, option("of the camera", "LEVELS")] = 2.0,
    histories: Annotated[int, option("random grips to learn from", "N")] = 12000,
    epochs: Annotated[int, option("passes over them", "N")] = 60,
    workers: Annotated[int, option("processes that simulate", "N")] = os.cpu_count() or 1,
    force: Annotated[Flag, option("write over an earlier file")] = False,
    json_only: Annotated[Flag, option("one JSON object", name="json")] = False,
) -> int:
    """Train a read-out of forces and friction on random grips of a sensor's own model.

    Interrupted, it goes on where it was when it is called again; needs the extra `learn`.
    """
    require("learn")
    for name, value, least in (
        ("histories", histories, 500), ("epochs", epochs, 1), ("workers", workers, 1)
    ):  # fmt: skip
        if value < least:
            raise UserError(f"--{name} {value}: expected {least} or more")
    if not 0.1 <= noise <= 50.0:
        raise UserError(f"--noise {noise:g}: expected 0.1 to 50 levels")
    if out.suffix != ".npz" or not out.parent.is_dir():
        raise UserError(f"read-out {out} must be a .npz file in a folder that is there")
    if out.is_dir() or (out.exists() and not force):
        raise UserError(f"read-out {out} exists; choose another or give --force")

    from ..calibrate.readout import train as learn
    from ..tracking import load_calibration

    with located(f"{calibration}"):
        known = load_calibration(calibration)
        if known.sensor.shape.flat:
            raise UserError(f"{calibration} is a flat pad, which the node model does not describe")
        with Console(stderr=True).status("starting") as status:
            errors = learn(known, noise, histories, epochs, out, workers, telling(status))
    if json_only:
        print(json.dumps({"readout": str(out), "histories": histories, "errors": errors}))
        return 0
    print(
        f"on histories it has not seen it misses by {errors['friction_n']:.3f} N of friction and "
        f"{errors['mu']:.3f} of µ, RMS over all noise levels"
    )
    print(f"read-out {out}, name it in a calibration as readout = {out.name!r}")
    return 0
