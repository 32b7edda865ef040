"""Methods by name: ours, installed plug-ins, anybody's `module:Class`, and objects from Python.

Each kind of method (tracker, reconstructor, controller, renderer, integrator) has one `Registry`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from .errors import UserError

#: A method as users choose it: a name, `module:Class`, or a class or other factory from Python.
Choice = str | Callable[..., Any]


@dataclass(frozen=True)
class Registry:
    """Methods of one kind.

    Parameters
    ----------
    protocol: methods that a class has to have; its name is the kind's
    package: where relative modules of `entries` lie
    entries: `.module:Class` and one line of description, by name
    """

    protocol: type
    package: str
    entries: Mapping[str, tuple[str, str]]

    @property
    def kind(self) -> str:
        """Name of the kind, such as `tracker`."""
        return self.protocol.__name__.lower()

    @property
    def group(self) -> str:
        """Group of the entry points of installed plug-ins, such as `chromagrip.trackers`."""
        return f"chromagrip.{self.kind}s"

    def descriptions(self) -> dict[str, str]:
        """One line about each method that can be chosen, by name; ours hide plug-ins."""
        plugins = {p.name: f"{p.value}, installed" for p in entry_points(group=self.group)}
        return plugins | {name: text for name, (_, text) in self.entries.items()}

    def check(self, name: str) -> None:
        """Refuse a name that is none of ours, no plug-in and no `module:Class`.

        Raises
        ------
        UserError
            With the names that there are.
        """
        if ":" not in name and name not in self.descriptions():
            known = ", ".join(self.descriptions())
            raise UserError(f"no {self.kind} {name!r}; there is {known}, or give module:Class")

    def load(self, choice: Choice, arguments: Mapping[str, Any] | None = None) -> Any:
        """Factory of a method: its class, with keyword arguments filled in.

        Parameters
        ----------
        choice: a name, `module:Class`, or a class or other factory
        arguments: for the class, by name

        Raises
        ------
        UserError
            When there is none of that name, it cannot be imported, or it lacks a method of the
            protocol.
        """
        factory = self._import(choice) if isinstance(choice, str) else choice
        return partial(factory, **arguments) if arguments else factory

    def _import(self, name: str) -> Any:
        if name in self.entries:
            module, _, kind = self.entries[name][0].partition(":")
            return getattr(import_module(module, self.package), kind)
        self.check(name)
        target = next((p.value for p in entry_points(group=self.group) if p.name == name), name)
        module, _, kind = target.partition(":")
        try:
            factory = getattr(import_module(module), kind)
        except (Exception, SystemExit) as reason:  # whatever somebody's module raises
            raise UserError(
                f"{self.kind} {name!r} cannot be imported: {type(reason).__name__}: {reason}"
            ) from reason
        for method in (key for key in vars(self.protocol) if not key.startswith("_")):
            if not hasattr(factory, method):
                home = self.protocol.__module__.rpartition(".")[0]
                raise UserError(
                    f"{self.kind} {name!r} has no {method}; see {home}.{self.protocol.__name__}"
                )
        return factory


def make(kind: str, name: str, factory: Callable[[], Any]) -> Any:
    """What a factory of somebody's makes.

    Raises
    ------
    UserError
        When it fails, with its error.
    """
    try:
        return factory()
    except (Exception, SystemExit) as reason:  # whatever somebody's class raises
        raise UserError(
            f"{kind} {name!r} cannot be made: {type(reason).__name__}: {reason}"
        ) from reason
