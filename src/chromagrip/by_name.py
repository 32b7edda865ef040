"""Methods by name: ours, installed plug-ins, any other `module:Class`, and objects from Python.

Each kind of method (tracker, reconstructor, controller, renderer, gripper, source) has
one `Registry`.
"""

import os
import sys
import traceback
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.metadata import entry_points
from operator import attrgetter
from pathlib import Path
from typing import Any

from .arguments import arguments_in, check_arguments, check_complete
from .errors import UserError, meant

#: A method as users choose it: a name, `module:Class`, or a class or other factory from Python.
Choice = str | Callable[..., Any]
#: Start of the name of a `module:Class` that a file names and that is not imported.
NOT_ALLOWED = "file:"
#: Keys of a file whose values are names of methods.
METHOD_KEYS = ("controller", "renderer", "tracker", "reconstructor")


@dataclass(frozen=True)
class Registry:
    """Methods of one kind.

    Parameters
    ----------
    protocol: methods that a class must have; its name in lower case is the kind's
    package: package of the relative modules in `entries`
    entries: `.module:Class` and one line of description, by name
    named: name of the kind, if it is not that of the protocol
    given: number of arguments that a factory gets before those of its choice
    """

    protocol: type
    package: str
    entries: Mapping[str, tuple[str, str]]
    named: str = ""
    given: int = 0

    @property
    def kind(self) -> str:
        """Name of the kind, such as `tracker`."""
        return self.named or self.protocol.__name__.lower()

    @property
    def group(self) -> str:
        """Group of the entry points of installed plug-ins, such as `chromagrip.trackers`."""
        return f"chromagrip.{self.kind}s"

    def descriptions(self) -> dict[str, str]:
        """Describe each available method in one line, by name; ours hide plug-ins."""
        plugins = {p.name: f"{p.value}, installed" for p in entry_points(group=self.group)}
        return plugins | {name: text for name, (_, text) in self.entries.items()}

    def check(self, name: str) -> None:
        """Refuse a name that is neither ours, nor a plug-in's, nor `module:Class`.

        Raises
        ------
        UserError
            For such a name; the message lists the available names.
        """
        if name in self.entries or ":" in name:  # installed plug-ins take milliseconds to list
            return
        if name not in self.descriptions():
            known = ", ".join(self.descriptions())
            question = method_meant(name, self.descriptions())
            raise UserError(
                f"no {self.kind} {name!r}{question}; there is {known}, or give module:Class"
            )

    def load(self, choice: Choice, arguments: Mapping[str, Any] | None = None) -> Any:
        """Factory of a method: its class, with keyword arguments filled in.

        Parameters
        ----------
        choice: a name, `module:Class`, `module:Class(name=value)`, or a class or other factory
        arguments: keyword arguments of the class, by name

        Raises
        ------
        UserError
            When the name is unknown, it cannot be imported, or it lacks a method of the protocol;
            for an argument that it does not take, or that is missing.
        """
        if isinstance(choice, str):
            choice, given = with_arguments(choice)
            arguments = {**given, **(arguments or {})}
        factory = self._import(choice) if isinstance(choice, str) else choice
        if isinstance(factory, type):
            self._check_methods(factory, name_of(choice))
        what = f"{self.kind} {name_of(choice)!r}"
        if arguments:
            check_arguments(what, factory, arguments, self.given)
            factory = partial(factory, **arguments)
        if self.given:
            check_complete(what, factory, self.given)
        return factory

    def build(self, choice: Choice | object, arguments: Mapping[str, Any] | None = None) -> Any:
        """Build a method by name, class or other factory; an object is returned as it is.

        Parameters
        ----------
        choice: an object with the methods of the protocol, or as in `load`
        arguments: as in `load`

        Raises
        ------
        UserError
            As in `load`, and when the factory raises an error.
        """
        name = name_of(choice)
        made = not isinstance(choice, str | type) and not self._lacking(choice)
        if made or not (isinstance(choice, str) or callable(choice)):
            self._check_methods(choice, name)
            return choice
        factory = self.load(choice, arguments)
        check_complete(f"{self.kind} {name!r}", factory)
        return make(self.kind, name, factory)

    def _import(self, name: str) -> Any:
        if name in self.entries:
            module, _, kind = self.entries[name][0].partition(":")
            return getattr(import_module(module, self.package), kind)
        self.check(name)
        if named := _marked(name):
            module = named.partition(":")[0]
            raise UserError(
                f"{self.kind} {named!r} stands in a file, whose code is not run unless you name "
                f"it: give --allow {module}, or allow=({module!r},) in Python"
            )
        target = next((p.value for p in entry_points(group=self.group) if p.name == name), name)
        factory = import_named(self.kind, name, target)
        self._check_methods(factory, name)
        return factory

    def _check_methods(self, method: object, name: str) -> None:
        """Refuse a class or an object that lacks a method of the protocol."""
        lacking = self._lacking(method)
        if lacking:
            home = ".".join(self.protocol.__module__.split(".")[:2])  # the stage exports it
            raise UserError(
                f"{self.kind} {name!r} has no {lacking[0]}; see {home}.{self.protocol.__name__}"
            )

    def _lacking(self, method: object) -> list[str]:
        """Methods of the protocol that a class or an object lacks."""
        required = (key for key in vars(self.protocol) if not key.startswith("_"))
        return [key for key in required if not hasattr(method, key)]


def method_meant(name: str, known: Iterable[str], what: str = "Class") -> str:
    """Question that names the known method, or the `module:Class`, that was meant; "" if none is.

    Parameters
    ----------
    name: as typed: almost a known one, a module in the working folder, or `module.Class`
    known: names of methods
    what: stands for the name that a module alone lacks
    """
    near, own = meant(name, known), _in_module(name, what)
    if near and own:
        return near.replace("?)", f" or {own}?)")
    return near or (own and f" (did you mean {own}?)")


def _in_module(name: str, what: str) -> str:
    whole = name.removesuffix(".py")
    module, _, last = whole.rpartition(".")
    if not all(word.isidentifier() for word in whole.split(".")):
        return ""
    path = whole.replace(".", "/")
    if any(map(os.path.isfile, (f"{path}.py", f"{path}/__init__.py"))):
        module, last = whole, what
    return f"{module}:{last}" if module else ""


def with_arguments(name: str) -> tuple[str, dict[str, Any]]:
    """Split `module:Class(gain=2)` into the class and its arguments, see `arguments_in`.

    Raises
    ------
    UserError
        For arguments that cannot be read, or of a name without a module.
    """
    method, bracket, rest = name.partition("(")
    if not bracket:
        return name, {}
    if ":" not in method or not rest.endswith(")"):
        raise UserError(f"{name}: expected module:Class(name=value), such as mine:Tracker(gain=2)")
    return method, arguments_in(rest[:-1], name)


def name_of(choice: Choice | object) -> str:
    """Name of a choice: itself, or the `module:Class` of a class, a factory or an object."""
    if isinstance(choice, str):
        return choice
    if isinstance(choice, partial):
        return name_of(choice.func)
    kind = choice if hasattr(choice, "__qualname__") else type(choice)
    return f"{kind.__module__}:{kind.__qualname__}"


def with_allowed(values: dict[str, Any], allow: Collection[str]) -> dict[str, Any]:
    """Values of a file in which every `module:Class` that is not allowed is marked.

    Opening a file thus never runs code that its writer chose: a marked name can be shown, and is
    refused when the method would be imported.

    Parameters
    ----------
    values: values of a scene or a recipe; methods may be at any depth, and under keys with dots
    allow: modules named by the user who starts the program; a package allows all its modules
    """
    for each in allow:
        if each.endswith(".py") or not all(part.isidentifier() for part in each.split(".")):
            raise UserError(f"--allow {each}: expected a module, such as mine of a file mine.py")

    def marked(name: str) -> str:
        module, colon, _ = name.partition(":")
        known = any(module == each or module.startswith(f"{each}.") for each in allow)
        return name if known or not colon else NOT_ALLOWED + name

    changed: dict[str, Any] = _with_names(values, marked)
    return changed


def as_in_file(values: dict[str, Any]) -> dict[str, Any]:
    """Values to be written to a file: names without the mark of `with_allowed`."""
    changed: dict[str, Any] = _with_names(values, lambda name: _marked(name) or name)
    return changed


def not_allowed(of: object) -> str:
    """First `module:Class` of a scene that is marked as not allowed; "" if there is no such."""
    return next(filter(None, (_marked(getattr(of, key)) for key in METHOD_KEYS)), "")


def _marked(name: str) -> str:
    """Name without its mark; "" if it has no mark: a module may be called file, too."""
    return name.removeprefix(NOT_ALLOWED) if name.count(":") > 1 else ""


def _with_names(value: Any, change: Callable[[str], str], method: bool = False) -> Any:
    """Values in which the names of methods are changed, at any depth."""
    if isinstance(value, dict):
        return {
            key: _with_names(each, change, method or key.rpartition(".")[2] in METHOD_KEYS)
            for key, each in value.items()
        }
    if isinstance(value, list | tuple):
        return [_with_names(each, change, method) for each in value]
    return change(value) if method and isinstance(value, str) else value


def import_named(kind: str, name: str, target: str = "") -> Any:
    """What a `module:name` stands for; the module may lie in the working folder.

    Parameters
    ----------
    kind: what it is, for a refusal
    name: as the user gave it
    target: `module:name` of an installed plug-in of that name

    Raises
    ------
    UserError
        When it cannot be imported.
    """
    _find_in_working_folder()
    module, _, attribute = (target or name).partition(":")
    who = f"{kind} {name!r}"
    if not module or not attribute or module.endswith(".py") or "/" in module:
        raise UserError(
            f"{who}: expected module:Class, such as mine:Class of a file mine.py in the working "
            "folder"
        )
    first, missing = attribute.partition(".")[0], ""
    with blaming(f"{who} cannot be imported", Exception, SystemExit):
        try:
            found = import_module(module)
            if hasattr(found, first):
                return attrgetter(attribute)(found)
        except ModuleNotFoundError as error:
            missing = error.name or ""
            if not missing or not f"{module}.".startswith(f"{missing}."):
                raise  # by the module itself
    if missing:
        raise UserError(
            f"{who}: there is no module {missing} in the working folder or the installation"
        )
    there = [word for word in dir(found) if not word.startswith("_")]
    alike = [word for word in there if word.lower() == first.lower()]
    question = f" (did you mean {alike[0]}?)" if alike else meant(first, there)
    raise UserError(f"{who}: module {module} has no {first}{question}")


def _find_in_working_folder() -> None:
    """Append the working folder to the import path.

    Only when a user names a module: a file there, such as `rerun.py`, must not hide a package.
    """
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.append(folder)


def make(kind: str, name: str, factory: Callable[[], Any]) -> Any:
    """Call the factory of a plug-in and return its object.

    Raises
    ------
    UserError
        When it fails, with its error.
    """
    given = " without arguments"
    if isinstance(factory, partial):
        given = f" with {', '.join(factory.keywords)}" if factory.keywords else ""
    with blaming(f"{kind} {name!r} cannot be made{given}", Exception, SystemExit):
        return factory()


@contextmanager
def blaming(failure: str, *errors: type[BaseException]) -> Iterator[None]:
    """Turn errors that a plug-in raises inside into a `UserError` with text and kind, if another.

    Parameters
    ----------
    failure: start of the message: which plug-in failed, and where
    errors: kinds that are the plug-in's failure. `SystemExit` always belongs here: a plug-in that
        ends the process has not succeeded.

    Raises
    ------
    UserError
        For an error of these kinds.
    """
    try:
        yield
    except errors as reason:
        kind = "" if isinstance(reason, UserError) else f"{type(reason).__name__}: "
        raise UserError(f"{failure}: {kind}{reason}{_origin(reason)}") from reason


def _origin(reason: BaseException) -> str:
    """File and line of a plug-in where an error was raised, for a message without a traceback.

    Empty where it was raised by Python's own import, or by our code.
    """
    calls = traceback.extract_tb(reason.__traceback__)
    ours = str(Path(__file__).parent)
    if not calls or calls[-1].filename.startswith(("<", ours)):
        return ""
    return f" ({Path(calls[-1].filename).name}, line {calls[-1].lineno})"


def named(choices: Iterable[Choice], load: Callable[[Choice], object]) -> dict[str, Choice]:
    """Choices by their name in rows; a class or other factory has its own name.

    Parameters
    ----------
    choices: names, `module:Class`, classes or other factories
    load: refuses a choice that cannot be loaded

    Raises
    ------
    UserError
        When there is none of that name, or it cannot be imported.
    """
    for choice in choices:
        load(choice)
    return {c if isinstance(c, str) else getattr(c, "__name__", repr(c)): c for c in choices}
