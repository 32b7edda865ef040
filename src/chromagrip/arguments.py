"""Arguments of a method by name: read from a text, and checked against its signature."""

import inspect
import re
from collections.abc import Mapping
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from .errors import UserError, meant
from .strict_toml import parse_toml

#: Words for the types of values that a text can give.
_WORDS: dict[type, str] = {
    str: "a text in quotes",
    bool: "true or false",
    int: "a whole number",
    float: "a number",
}
#: Types of such values; an object from Python is not checked.
_TEXTUAL = (str, bool, int, float, list, dict)


def arguments_in(text: str, name: str) -> dict[str, Any]:
    """Arguments of a text `gain=2, port=/dev/ttyUSB0`: TOML, or words without quotes.

    Parameters
    ----------
    text: text between the brackets
    name: whole text for messages

    Raises
    ------
    UserError
        For any other text.
    """
    # After a key at the begin or after a comma, and no word of TOML.
    word = r"((?:^|,)\s*[\w-]+\s*=\s*)(?!(?:true|false|inf|nan)\b)([^\W\d][^\s,]*|[/~][^\s,]*)"
    quoted = re.sub(word + r"(?=\s*(?:,|$))", r'\1"\2"', text)
    return dict(parse_toml(f"values = {{{quoted}}}", name)["values"])


def check_arguments(what: str, factory: Any, arguments: Mapping[str, Any], given: int = 0) -> None:
    """Refuse arguments that a factory does not take, or of another type than it names.

    Parameters
    ----------
    what: kind and name of the method, for messages
    factory: class or other factory; one of unknown signature takes all
    arguments: arguments by name
    given: number of arguments that it gets before those

    Raises
    ------
    UserError
        For such an argument; the message tells what is allowed.
    """
    parameters = _parameters(factory, given)
    if parameters is None:
        return
    anything = any(one.kind == one.VAR_KEYWORD for one in parameters)
    taken = {one.name: one for one in _named(parameters)}
    for name, value in arguments.items():
        if name in taken:
            expected = _expected(taken[name].annotation, value)
            if expected:
                raise UserError(f"{what}: {name} = {value!r}; expected {expected}")
        elif not anything:
            raise UserError(
                f"{what} has no argument {name}{meant(name, taken)}; {_there(parameters)}"
            )


def check_complete(what: str, factory: Any, given: int = 0) -> None:
    """Refuse a factory that needs more arguments than it has.

    Parameters
    ----------
    what, given: see `check_arguments`
    factory: factory, with the named arguments filled in

    Raises
    ------
    UserError
        When one is missing; the message names all that are, and what is allowed.
    """
    parameters = _parameters(factory, given) or []
    variable = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    missing = [p for p in parameters if p.default is p.empty and p.kind not in variable]
    if missing:
        named = [one.name + _in_brackets(one.annotation) for one in missing]
        raise UserError(f"{what} needs {' and '.join(named)}; {_there(parameters)}")


def _parameters(factory: Any, given: int) -> list[inspect.Parameter] | None:
    """Parameters after those that are given by position; None where they are not known."""
    try:
        signature = inspect.signature(factory, eval_str=True)
    except Exception:  # a name in quotes that cannot be found, or any error of a stranger's code
        try:
            signature = inspect.signature(factory)
        except (TypeError, ValueError):
            return None
    parameters = list(signature.parameters.values())
    by_place = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    first = [one for one in parameters if one.kind in by_place][:given]
    return [one for one in parameters if one not in first]


def _named(parameters: list[inspect.Parameter]) -> list[inspect.Parameter]:
    """Parameters that can be given by name."""
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return [one for one in parameters if one.kind in by_name]


def _there(parameters: list[inspect.Parameter]) -> str:
    names = ", ".join(one.name for one in _named(parameters))
    return f"it has {names}" if names else "it has none"


def _options(annotation: object) -> list[object]:
    """Types and literal values that an annotation allows, but for None; `object` for others."""
    options: list[object] = []
    union = get_origin(annotation) in (Union, UnionType)
    for one in get_args(annotation) if union else (annotation,):
        if get_origin(one) is Literal:
            options += get_args(one)
        elif one is not NoneType:
            options.append(one if isinstance(one, type) else object)
    return options


def _words(option: object) -> str:
    """Words for a type, or a literal value; empty for another type."""
    if isinstance(option, type):
        return _WORDS.get(option, "")
    return str(option)


def _in_brackets(annotation: object) -> str:
    """Words for what an annotation allows, in brackets; empty where they are not known."""
    words = [_words(option) for option in _options(annotation)]
    return f" ({' or '.join(words)})" if all(words) else ""


def _expected(annotation: object, value: Any) -> str:
    """Words for what is allowed in place of a value; empty if it fits, or that is not known."""
    options = _options(annotation)
    words = [_words(option) for option in options]
    if type(value) not in _TEXTUAL or not all(words):
        return ""
    return "" if any(_fits(option, value) for option in options) else " or ".join(words)


def _fits(option: object, value: Any) -> bool:
    """Whether a value has a type, or is that literal value; True is no number."""
    if not isinstance(option, type):
        return type(value) is type(option) and bool(value == option)
    if option is float:
        return type(value) in (int, float)
    return type(value) is option
