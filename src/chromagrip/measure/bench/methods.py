"""Methods that a bench is asked to measure: each once, by the name that its rows have."""

from collections.abc import Callable, Iterable

from ...by_name import Choice


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
