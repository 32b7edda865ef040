"""Studies: what is measured, as data, and the table of those that can be asked for.

A study is a function with a decorator. It says what is measured one by one, how, and what the
results come to. `engine.run_study` does the rest: processes, resuming, progress and files.

    @study("bench", "size", method="tracker")
    def marker_sizes(asked: Asked) -> Study[Size, float]:
        \"\"\"Error of a tracker over the size of the markers.\"\"\"
        return Study(settings=[...], measure=error_of, result=float, report=report_of)

The command `chromagrip bench size` then exists, with --tracker, --quick, --json and --out.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import walk_packages
from typing import Any, Generic, Literal, TypeVar

from ..by_name import Choice, import_named, named
from ..errors import UserError, meant
from ..output.page import PageSection
from ..output.report import Report
from ..scene.scene import load_scene

Setting = TypeVar("Setting")
Result = TypeVar("Result")
#: Every setting that was measured, in the order of the study, with its result.
Results = Sequence[tuple[Setting, Result]]
#: Kinds of methods that a study can compare.
Kind = Literal["", "tracker", "reconstructor", "controller"]


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What is asked of a study.

    Attributes
    ----------
    quick: measure less of everything
    methods: names, `module:Class`, `module:Class(name=value)` or classes of the study's kind of
        method; none are its own choice, and one of the user's own stands beside that choice
    only: parts of the study; none are all
    world: name of the world; empty is the study's first choice
    """

    quick: bool = False
    methods: tuple[Choice, ...] = ()
    only: tuple[str, ...] = ()
    world: str = ""

    @property
    def beside(self) -> bool:
        """Whether a method of the user's own is asked for, which the study's stand beside."""
        return any(not isinstance(one, str) or ":" in one for one in self.methods)

    def compared(self, usual: Iterable[Choice]) -> list[Choice]:
        """Methods to compare, each once: those asked for, and the usual ones where they belong."""
        ours = usual if self.beside or not self.methods else ()
        return list(dict.fromkeys([*self.methods, *ours]))

    def chosen(
        self,
        usual: Iterable[Choice],
        load: Callable[[Choice], object],
        first: Sequence[Choice] = (),
    ) -> dict[str, Choice]:
        """Methods to compare, by their name in rows.

        Parameters
        ----------
        usual: see `compared`
        load: refuses a choice that cannot be loaded
        first: compared whatever is asked for

        Raises
        ------
        UserError
            When there is none of that name, or it cannot be imported.
        """
        return named((*first, *self.compared(usual)), load)


def controllers_of(asked: Asked, scene: str, usual: Iterable[str]) -> tuple[str, ...]:
    """Controllers to compare, see `Asked.compared`.

    Parameters
    ----------
    scene: shipped scene that each has to be able to control

    Raises
    ------
    UserError
        When there is no such controller.
    """
    names = tuple(map(str, asked.compared(usual)))
    for name in names:
        load_scene(scene, {"controller": name}).build_controller()
    return names


#: Everything that a study measures by itself.
ALL = Asked()


@dataclass(frozen=True, kw_only=True)
class Study(Generic[Setting, Result]):
    """What is measured.

    Attributes
    ----------
    measure: result of a setting; a function of a module, called in a process with one thread
    result: type of a result: numbers, texts, arrays, and dataclasses or tuples of them
    report: rows, tables and notes from all results
    settings: measured several at a time; values that JSON can hold, and methods
    words: a setting in words, for the progress
    timed: settings that are measured after the others, one at a time, because they take times
    more: settings that the results so far ask for; none ends the study
    show: writes pictures and tables into a folder; returns the sections of the page with them
    """

    measure: Callable[[Setting], Result]
    result: Any
    report: Callable[[Results[Setting, Result]], Report]
    settings: Sequence[Setting] = ()
    words: Callable[[Setting], str] = str
    timed: Sequence[Setting] = ()
    more: Callable[[Results[Setting, Result]], Sequence[Setting]] = lambda results: ()
    show: Callable[[Results[Setting, Result], Path], Sequence[PageSection]] = lambda results, to: ()


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A study in the table.

    Attributes
    ----------
    verb, part: words of the command line, such as `bench` and `force`
    worlds: that it measures in, the first without being asked; `("",)` has no choice
    method: kind of the methods that it can compare; empty is none
    parts: that can be asked for alone
    of_parts: option that names one of `parts`, such as `scene`
    example: options of the command in the example of its help, which takes a few seconds
    make: the study itself
    """

    verb: str
    part: str
    worlds: tuple[str, ...]
    method: Kind
    parts: tuple[str, ...]
    of_parts: str
    example: str = "--quick"
    make: Callable[[Asked], Study[Any, Any]] = field(repr=False)

    @property
    def text(self) -> str:
        """What is measured, in one line."""
        return (self.make.__doc__ or "").splitlines()[0]


_ENTRIES: dict[tuple[str, str, tuple[str, ...]], Entry] = {}
#: Packages of studies; every module in them is imported when the table is asked for.
_PACKAGES = ("bench", "charts", "stability")


def study(
    verb: str,
    part: str,
    *,
    worlds: tuple[str, ...] = ("",),
    method: Kind = "",
    parts: Sequence[str] = (),
    of_parts: str = "",
    example: str = "--quick",
) -> Callable[[Callable[[Asked], Study[Any, Any]]], Callable[[Asked], Study[Any, Any]]]:
    """Decorator that enters a function into the table of studies; see `Entry`."""

    def enter(make: Callable[[Asked], Study[Any, Any]]) -> Callable[[Asked], Study[Any, Any]]:
        entry = Entry(
            verb=verb,
            part=part,
            worlds=worlds,
            method=method,
            parts=tuple(parts),
            of_parts=of_parts,
            example=example,
            make=make,
        )
        _ENTRIES[verb, part, worlds] = entry
        return make

    return enter


@cache
def _load() -> None:
    """Import every module that may hold a study."""
    for plugin in entry_points(group="chromagrip.studies"):
        import_named("study", plugin.name, plugin.value)
    for name in _PACKAGES:
        package = import_module(f".{name}", __package__)
        for module in walk_packages(package.__path__, f"{package.__name__}."):
            import_module(module.name)


def own_study(name: str) -> Entry:
    """Enter a study of one's own, `module:function`, into the table.

    Raises
    ------
    UserError
        When it cannot be imported, or is no study.
    """
    made = import_named("study", name)
    entry = next((one for one in _ENTRIES.values() if one.make is made), None)
    if entry is None:
        raise UserError(f"{name} is no study: it lacks the decorator `chromagrip.measure.study`")
    return entry


def studies(verb: str) -> dict[str, list[Entry]]:
    """Studies of a command by their part; a part may have one for each of several worlds."""
    _load()
    found: dict[str, list[Entry]] = {}
    for key in sorted(_ENTRIES):
        entry = _ENTRIES[key]
        if entry.verb == verb:
            found.setdefault(entry.part, []).append(entry)
    return found


def find_study(verb: str, part: str, asked: Asked) -> Entry:
    """The study of a part in the world that is asked for.

    Raises
    ------
    UserError
        When there is none, or it does not have what is asked for.
    """
    entries = studies(verb).get(part, [])
    if not entries:
        raise UserError(f"no {verb} {part!r}; there is {', '.join(studies(verb))}")
    if asked.world:
        able = [one for one in entries if asked.world in one.worlds]
    else:  # the usual one first
        able = sorted(entries, key=lambda one: "" not in one.worlds)
    if not able:
        known = ", ".join(world for one in entries for world in one.worlds if world)
        raise UserError(f"{verb} {part} has no world {asked.world!r}; there is {known or 'none'}")
    entry = next((one for one in able if set(asked.only) <= set(one.parts)), able[0])
    where = f"{verb} {part}" + (f" --world {asked.world}" if asked.world else "")
    if asked.methods and not entry.method:
        raise UserError(f"{where} compares no methods, got {asked.methods[0]!r}")
    unknown = [name for name in asked.only if name not in entry.parts]
    if unknown:
        known, kind = ", ".join(entry.parts) or "none", entry.of_parts or "part"
        question = meant(unknown[0], entry.parts)
        raise UserError(f"{where} has no {kind} {unknown[0]!r}{question}; there is {known}")
    return entry
