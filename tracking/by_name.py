"""Classes of anybody's, by `module:Class`."""

from importlib import import_module
from typing import Any


def import_class(target: str, name: str, what: str, error: type[ValueError]) -> Any:
    """Class at `module:Class` that can be reset and updated.

    Parameters
    ----------
    target: where it is
    name: by which it was asked for
    what: it is to be, in messages; its protocol is chromagrip.tracking's of that name
    error: raised when it cannot be imported, or is none
    """
    module, _, kind = target.partition(":")
    try:
        found = getattr(import_module(module), kind)
    except Exception as reason:  # whatever a foreign module raises while it is imported
        raise error(
            f"{what} {name!r} cannot be imported: {type(reason).__name__}: {reason}"
        ) from None
    for method in ("reset", "update"):
        if not hasattr(found, method):
            raise error(
                f"{what} {name!r} has no {method}; see chromagrip.tracking.{what.capitalize()}"
            )
    return found
