"""Classes of anybody's, by `module:Class`."""

from importlib import import_module
from typing import Any


def import_class(target: str, name: str, protocol: type, error: type[ValueError]) -> Any:
    """Class at `module:Class` that has the methods of a protocol.

    Parameters
    ----------
    target: where it is
    name: by which it was asked for
    protocol: of ours that it is to follow; its name is what messages call it
    error: raised when it cannot be imported, or is none
    """
    what = protocol.__name__.lower()
    module, _, kind = target.partition(":")
    try:
        found = getattr(import_module(module), kind)
    except Exception as reason:  # whatever a foreign module raises while it is imported
        raise error(
            f"{what} {name!r} cannot be imported: {type(reason).__name__}: {reason}"
        ) from None
    for method in (key for key in vars(protocol) if not key.startswith("_")):
        if not hasattr(found, method):
            home = protocol.__module__.rpartition(".")[0]
            raise error(f"{what} {name!r} has no {method}; see {home}.{protocol.__name__}")
    return found
