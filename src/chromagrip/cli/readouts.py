"""The command `list readouts`, and the training of a read-out that a sensor lacks."""

import json
import sys
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import tyro
from rich.table import Table

from ..errors import UserError, located
from ..folders import remove
from .options import (
    CORES,
    Flag,
    Json,
    counting,
    option,
    print_list,
    print_table,
    status,
    value_table,
)

if TYPE_CHECKING:  # OpenCV loads only when something is run
    from ..model import Dome, SoftBody
    from ..scene.scene import Scene
    from ..tracking import SensorCalibration


def prepare(known: "SensorCalibration", reconstructor: str) -> None:
    """Make what a reconstructor needs of a sensor where none is kept: a read-out, or tables.

    Raises
    ------
    UserError
        When it cannot be trained, solved or kept.
    """
    from ..render import layer_depths
    from ..tracking.forces import DOME_METHODS, name_used

    if name_used(reconstructor, known) in DOME_METHODS and known.sensor.silicone is not None:
        dome = known.sensor.dome
        _solve(dome, layer_depths(known.sensor, dome))
    else:
        train_if_missing(known, reconstructor)


def train_if_missing(known: "SensorCalibration", reconstructor: str) -> None:
    """Train the read-out that a reconstructor needs, where the sensor has none yet.

    Raises
    ------
    UserError
        When it cannot be trained or kept.
    """
    from ..tracking.forces import needs_readout

    if known.readout is not None or not needs_readout(reconstructor, known):
        return

    from ..calibrate.first_use import ensure_readout, training_notice

    print(f"chromagrip: {training_notice(known)}", file=sys.stderr, flush=True)
    if known.sensor.silicone is not None:
        print(
            "chromagrip: as a dome of silicone (--body dome) it is read without a training",
            file=sys.stderr,
            flush=True,
        )
    with status() as report:
        ensure_readout(known, report, CORES)


def prepare_scene(scene: "Scene", pictures: bool) -> None:
    """Make what a run of a scene needs and is not kept yet: a dome's tables and a read-out.

    Parameters
    ----------
    scene: that will be run
    pictures: whether pictures of it are drawn
    """
    from ..loop.methods import reconstructor_for
    from ..scene.controllers import CONTROLLERS
    from ..sensing.reader import known_sensor

    CONTROLLERS.load(scene.controller)  # what is typed wrong is refused before tables are solved
    with located(f"sensor {scene.sensor}"):
        read = scene.path == "camera"
        name = reconstructor_for(scene.body, scene.reconstructor) if read else ""
    make_dome_tables(scene, pictures)
    if read and not scene.build_sensor().shape.flat:
        with located(f"sensor {scene.sensor}"):
            train_if_missing(known_sensor(scene), name)


def make_dome_tables(scene: "Scene", pictures: bool) -> None:
    """Solve the elasticity of a scene's dome where none is kept; for pictures at its markers too.

    Raises
    ------
    UserError
        For a layer of markers below the silicone.
    """
    {"chain": _no_tables, "dome": _dome_tables}[scene.body](scene, pictures)


def _no_tables(scene: "Scene", pictures: bool) -> None:
    """A chain needs no tables."""


def _dome_tables(scene: "Scene", pictures: bool) -> None:
    from ..render import layer_depths

    shape = scene.build_solid().shape
    for note in shape.notes:
        print(f"chromagrip: {shape.name}: {note}", file=sys.stderr, flush=True)
    dome = scene.build_dome()
    _solve(dome, layer_depths(scene.build_sensor(), dome) if pictures else ())


def _solve(dome: "SoftBody", depths: Iterable[float]) -> None:
    """Solve what is not kept of a dome's elasticity, and of its motion at depths [m]."""
    from ..model.dome import compliance_table, inside_table

    if dome.closed_form:
        return
    with _table("elasticity of the dome") as progress:
        compliance_table(dome, progress)
    for depth in depths:
        with _table(f"motion of the markers {1e3 * depth:.2f} mm deep in the dome") as progress:
            inside_table(cast("Dome", dome), depth, progress)


def _table(what: str) -> AbstractContextManager[Callable[..., None]]:
    """Bar of a table that is kept for later commands."""
    logged = f"solving the {what}, once; this takes some seconds"
    return counting(f"{what}, once", "harmonics", logged=logged)


def _list_readouts(json_only: bool) -> int:
    """Where the read-out of each shipped sensor lies that has one."""
    from ..render import sensor_names
    from ..tracking import load_calibration
    from ..tracking.forces.chain import readout_origin

    entries = {}
    for name in sensor_names():
        known = load_calibration(name)
        if known.readout is not None:
            entries[name] = readout_origin(known.readout, known)
    for folder, name in unfinished_trainings().items():
        megabytes = sum(file.stat().st_size for file in folder.glob("*")) / 1e6
        entries[f"{name}, training"] = (
            f"unfinished, {megabytes:.0f} MB in {folder}; the same command goes on with it, "
            "--remove-unfinished removes it"
        )
    return print_list(entries, json_only)


def unfinished_trainings() -> dict[Path, str]:
    """Folder of each training in the user's cache that was interrupted, with its sensor's name."""
    from ..render import load_sensor, sensor_names
    from ..tracking.forces import kept_path

    named: dict[Path, str] = {}
    for name in sensor_names():
        with suppress(UserError):  # without a cache there is none
            path = kept_path(load_sensor(name))
            named[path.with_name(f"{path.name}.parts")] = name
    found = {folder for path in named for folder in path.parent.glob("*.parts") if folder.is_dir()}
    return {folder: named.get(folder, "a sensor of one's own") for folder in sorted(found)}


def readouts(
    sensor: Annotated[
        str | None,
        tyro.conf.Positional,
        option("sensor, the file of its calibration, or a read-out", "SENSOR|FILE.toml|FILE.npz"),
    ] = None,
    *,
    remove_unfinished: Annotated[
        Flag, option("remove the parts of trainings that were interrupted")
    ] = False,
    json_only: Json = False,
) -> int:
    """List the trained read-outs of the shipped sensors, or show one with its training ranges.

    Example: chromagrip list readouts thesis
    """
    if remove_unfinished:
        for folder in unfinished_trainings():
            remove(folder)
            print(f"removed {folder}", file=sys.stderr)
    if sensor is None:
        return _list_readouts(json_only)

    from ..calibrate.training_ranges import range_lines
    from ..tracking import load_calibration
    from ..tracking.forces import required_readout
    from ..tracking.forces.chain import load_readout, readout_digest, readout_origin

    if sensor.endswith(".npz"):
        path, origin = Path(sensor), Path(sensor).name
    else:
        known = load_calibration(sensor)
        path = required_readout(known)
        origin = readout_origin(path, known)
    ranges = load_readout(path).ranges
    about = {"readout": str(path), "origin": origin, "digest": readout_digest(path)}
    if json_only:
        print(json.dumps({**about, "ranges": ranges}, ensure_ascii=False))
        return 0
    table = value_table()
    for name, value in about.items():
        table.add_row(name, value)
    training = ranges.get("training")
    for name, value in (training if isinstance(training, dict) else {}).items():
        table.add_row(name.replace("_", " "), json.dumps(value).strip("[]{}").replace('"', ""))
    print_table(table)
    lines = Table("range", "unit", "from", "to", "", box=None, padding=(0, 2))
    for line in range_lines(ranges):
        lines.add_row(*line)
    print_table(lines)
    return 0
