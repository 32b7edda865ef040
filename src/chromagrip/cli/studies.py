"""The commands of the studies, made from their table: an option that a study lacks is not there."""

from collections.abc import Callable, Iterable, Sequence
from inspect import Parameter, Signature
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from ..measure.engine import UNFINISHED, measure
from ..measure.study import Asked, Entry, studies
from .measure import print_result
from .options import (
    CORES,
    JsonOnly,
    Out,
    Overwrite,
    Quick,
    Workers,
    check_least,
    going_on,
    new_folder,
    option,
    status,
)

#: Start of the command line of studies that `chromagrip` itself does not offer.
_STARTS = {"project": "./run bench"}
#: Options that every study has, with their types.
_SHARED: dict[str, Any] = {
    "workers": Workers,
    "quick": Quick,
    "out": Out,
    "overwrite": Overwrite,
    "json_only": JsonOnly,
}
_SHARED_VALUES = {"workers": CORES, "out": None}
_METHOD = (
    "{} to compare; may be repeated; names of ours are measured alone, and a class of your own "
    "stands beside the study's; its arguments are in brackets, such as mine:Class(gain=2)"
)


def commands(verb: str) -> dict[str, Callable[..., int]]:
    """Command of every part of a verb, by its two words."""
    return {f"{verb} {part}": _command(entries) for part, entries in studies(verb).items()}


def _command(entries: Sequence[Entry]) -> Callable[..., int]:
    """Command that runs the studies of one part; `entries` has one for each group of worlds."""
    verb, part = entries[0].verb, entries[0].part

    def command(
        *,
        quick: bool,
        out: Path | None,
        overwrite: bool,
        workers: int,
        json_only: bool,
        methods: tuple[str, ...] = (),
        only: tuple[str, ...] = (),
        world: str = "",
    ) -> int:
        check_least(workers=(workers, 1))
        asked = Asked(quick=quick, methods=methods, only=only, world=world)
        if out is None and not json_only:
            out = new_folder("-".join(filter(None, (verb, part, world))))
        with status() as report, going_on(out, UNFINISHED):
            result = measure(
                verb,
                part,
                asked,
                out=out,
                overwrite=overwrite,
                workers=workers,
                progress=report,
            )
        return print_result(result, out, json_only)

    own = _own_options(entries)
    kinds = {**own, **_SHARED}
    values = {name: "" if name == "world" else () for name in own} | _SHARED_VALUES
    command.__annotations__ = {**kinds, "return": int}
    command.__dict__["__signature__"] = Signature(
        [
            Parameter(
                name, Parameter.KEYWORD_ONLY, default=values.get(name, False), annotation=kind
            )
            for name, kind in kinds.items()
        ]
    )
    command.__doc__ = _description(entries)
    return command


def _own_options(entries: Sequence[Entry]) -> dict[str, Any]:
    """Options that the studies of a part have, with their types."""
    options: dict[str, Any] = {}
    worlds = [world for entry in entries for world in entry.worlds if world]
    method = next((entry.method for entry in entries if entry.method), "")
    parts = _united(entry.parts for entry in entries)
    if worlds:
        options["world"] = Annotated[
            Literal[("", *worlds)],
            option("kind of scenes, instead of the usual one", "|".join(worlds)),
        ]
    if method:
        options["methods"] = Annotated[
            tuple[str, ...],
            tyro.conf.UseAppendAction,
            option(_METHOD.format(method), "NAME|MODULE:CLASS", method),
        ]
    if parts:
        name = next(entry.of_parts for entry in entries if entry.of_parts)
        options["only"] = Annotated[
            tuple[str, ...],
            tyro.conf.UseAppendAction,
            option(f"{name} to measure alone; may be repeated: {', '.join(parts)}", "NAME", name),
        ]
    return options


def _united(groups: Iterable[Sequence[str]]) -> list[str]:
    return list(dict.fromkeys(one for group in groups for one in group))


def _description(entries: Sequence[Entry]) -> str:
    """Text of the command's help: what each study measures, and an example."""
    verb, part = entries[0].verb, entries[0].part
    usual, *others = sorted(entries, key=lambda entry: "" not in entry.worlds)
    lines = [usual.text, ""]
    for entry in others:
        lines += [f"With --world {'|'.join(entry.worlds)}: {entry.text}", ""]
    lines += ["An interrupted study continues when it is called again with the same --out.", ""]
    start = _STARTS.get(verb, f"chromagrip {verb}")
    return "\n".join([*lines, f"Example: {start} {part} {usual.example}"])
