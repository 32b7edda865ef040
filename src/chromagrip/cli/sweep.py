"""The command `sweep`: settings × scenes × seeds."""

import sys
from typing import Annotated, Any

import tyro

from ..errors import UserError
from ..scene.scene import DEFAULT_SCENE, PathName, parse_change
from ..strict_toml import parse_toml
from .measure import print_result
from .options import (
    CORES,
    Allow,
    Changes,
    JsonOnly,
    Out,
    Overwrite,
    Workers,
    check_least,
    counting,
    new_folder,
    option,
)
from .readouts import prepare_scene


def sweep(
    *,
    vary: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option("values of a key, such as object.friction=0.3,0.5; may be repeated", "KEY=V,V,…"),
    ] = (),
    arguments: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option("values of an argument of a controller's class", "NAME=V,V,…", "arg"),
    ] = (),
    scenes: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option("see `chromagrip scenes`, or a file; may be repeated", "NAME|FILE.toml", "scene"),
    ] = (),
    controllers: Annotated[
        tuple[str, ...],
        tyro.conf.UseAppendAction,
        option("instead of the scene's; may be repeated", "NAME|MODULE:CLASS", "controller"),
    ] = (),
    path: Annotated[
        PathName | None, option("input of the controller, instead of the scene's", "camera|truth")
    ] = None,
    seeds: Annotated[int, option("runs of each, with seeds from the scene's on", "N")] = 3,
    changes: Changes = (),
    allow: Allow = (),
    answer_within: Annotated[
        float, option("time in which a module:Class must answer; inf is no limit", "SECONDS")
    ] = 60.0,
    workers: Workers = CORES,
    out: Out = None,
    overwrite: Overwrite = False,
    json_only: JsonOnly = False,
) -> int:
    """Run a controller with many settings, in many scenes, with several seeds.

    An interrupted sweep continues when it is called again with the same --out.

    Example: chromagrip sweep --vary safety_margin.integral_n_per_s=10,30,90 --path truth --seeds 1
    """
    check_least(seeds=(seeds, 1), workers=(workers, 1))
    if not answer_within > 0.0:
        raise UserError(f"--answer-within {answer_within}: expected more than 0; inf is no limit")
    axes = [_axis(text, "--vary", "") for text in vary]
    axes += [_axis(text, "--arg", "controller_arguments.") for text in arguments]
    fixed = dict(parse_change(text) for text in changes)
    if path is not None:
        fixed["path"] = path
    if controllers:
        axes.insert(0, ("controller", controllers))
    names = [name for name, _ in axes]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise UserError(f"{twice[0]} is varied twice; give all its values at once")

    from ..measure.sweep.runs import Plan, tasks
    from ..measure.sweep.sweep import sweep as measure_sweep

    plan = Plan(
        scenes=tuple(dict.fromkeys(scenes)) or (DEFAULT_SCENE,),
        axes=tuple(axes),
        seeds=seeds,
        fixed=fixed,
        answer_within_s=answer_within,
        allow=allow,
    )
    wanted = tasks(plan)  # refuses what cannot be run before a folder is made
    kinds = {(one.scene.sensor, one.scene.path, one.scene.body): one.scene for one in wanted}
    for scene in kinds.values():  # once, not in each worker
        prepare_scene(scene, pictures=scene.path == "camera")
    if out is None and not json_only:
        out = new_folder("sweep")
    try:
        with counting(f"{len(wanted)} runs", "runs") as progress:
            report = measure_sweep(plan, out, overwrite, workers, progress)
    except KeyboardInterrupt:
        if out is not None and out.exists():
            print(
                f"chromagrip: what is done is in {out}; call it again with --out {out} to go on",
                file=sys.stderr,
            )
        raise
    return print_result(report, out, json_only)


def _axis(text: str, flag: str, prefix: str) -> tuple[str, tuple[Any, ...]]:
    """Key and values of KEY=V,V,…; values are TOML, or texts without quotes."""
    key, equals, values = text.partition("=")
    if not equals or not key.strip() or not values.strip():
        raise UserError(f"{flag} {text}: expected values, such as object.friction=0.3,0.5")
    try:
        found = parse_toml(f"values = [{values}]", flag)["values"]
    except UserError:
        found = [parse_change(f"{key}={value}")[1] for value in values.split(",")]
    kept = list(dict.fromkeys(map(_hashable, found)))
    return prefix + key.strip(), tuple(kept)


def _hashable(value: Any) -> Any:
    return tuple(map(_hashable, value)) if isinstance(value, list) else value
