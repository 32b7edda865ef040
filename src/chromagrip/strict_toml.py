"""Strict tables, read from TOML; a key or value that is not allowed is refused by name."""

import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import msgspec

from .errors import UserError, meant

#: Number of a table above 0 and up to 10⁹.
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e9)]
#: Number of a table from 0 up to 10⁹.
NotNegative = Annotated[float, msgspec.Meta(ge=0.0, le=1e9)]
#: Keys and values of a TOML table.
Values = dict[str, Any]


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A TOML table that refuses unknown keys."""


Kind = TypeVar("Kind", bound=Table)


#: Largest TOML file [bytes]; a scene, sensor or palette has some kilobytes.
MOST_BYTES = 10_000_000


def read_toml(path: Path, name: str) -> Values:
    """Read the values of a TOML file.

    Parameters
    ----------
    path: path of the file
    name: name of the file in messages, such as `scene mine.toml`

    Raises
    ------
    UserError
        When the file cannot be read, is larger than `MOST_BYTES`, or is not valid TOML.
    """
    try:
        with path.open("rb") as file:  # a device has no size to ask for
            data = file.read(MOST_BYTES + 1)
        if len(data) > MOST_BYTES:
            raise UserError(f"{name} is larger than {MOST_BYTES / 1e6:g} MB")
        text = data.decode().replace("\r\n", "\n").replace("\r", "\n")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise UserError(f"{name} cannot be read: {reason}") from None
    return parse_toml(text, name)


def parse_toml(text: str, name: str) -> Values:
    """Parse a TOML text; errors as in `read_toml`."""
    try:
        values = tomllib.loads(text)
        _refuse_null(values)
    except ValueError as error:  # also of a number with thousands of digits
        raise UserError(f"{name} is not valid TOML: {error}") from None
    except RecursionError:
        raise UserError(f"{name} is not valid TOML: it is nested too deeply") from None
    return values


def _refuse_null(value: Any) -> None:
    """Refuse the null character, which no name of a file can hold."""
    if isinstance(value, str) and "\0" in value:
        raise ValueError(f"{value!r} holds a null character")
    if isinstance(value, dict):
        value = [*value, *value.values()]
    if isinstance(value, list):
        for part in value:
            _refuse_null(part)


def convert(values: Values, kind: type[Kind], name: str) -> Kind:
    """Build a table of that kind from plain values.

    Raises
    ------
    UserError
        For a value that is not allowed, with `name`, key, value and what is allowed.
    """
    _refuse_unknown(values, kind, name, "", kind)
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        message, _, place = str(error).partition(" - at `$")
        key = place.rstrip("`").lstrip(".")
        found = _get(values, key) if key else None
        at = f"{key}: " if isinstance(found, dict) else f"{key} = {found!r}: " if key else ""
        raise UserError(f"{name}: {at}{_plain(message, key, kind)}") from None


def _plain(message: str, key: str, kind: Any) -> str:
    """Rewrite a validator's message in the words of TOML."""
    if message.startswith("Invalid enum value"):
        for part in key.split("."):
            kind = get_type_hints(kind)[part]
        if type(None) in get_args(kind):  # a key that may be left out
            kind = get_args(kind)[0]
        return f"allowed: {', '.join(get_args(kind))}"
    if message.startswith("Invalid value "):  # the tag of a union
        *tables, tag = key.split(".")
        for part in tables:
            kind = get_type_hints(kind)[part]
        allowed = [str(member.__struct_config__.tag) for member in _members(kind)]
        return f"{tag} must be one of {', '.join(allowed)}"
    wanted = message.partition("`")[2].partition("`")[0]
    if message.startswith("Object missing required field"):
        return f"the key {wanted} is missing"
    for type_name, word in _WORDS.items():
        message = message.replace(f"`{type_name}`", word)
    example = _EXAMPLES.get(wanted, "") if ", got " in message else ""  # not out of bounds
    return message[0].lower() + message[1:] + (f", such as {example}" if example else "")


_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "object": "a table",
    "array": "a list",
    "bool": "true or false",
}


#: A value of each type, for a message.
_EXAMPLES = {"float": "0.5", "int": "3", "array": "[0.2, 0.5]"}


def _members(kind: Any) -> tuple[Any, ...]:
    """Tables that a key may hold."""
    members = get_args(kind) if isinstance(kind, UnionType) else (kind,)
    return tuple(m for m in members if isinstance(m, type) and issubclass(m, Table))


def _get(values: Any, key: str) -> Any:
    for part in key.replace("[", ".[").split("."):
        if part.startswith("["):
            index = part.strip("[]")
            values = values[int(index)] if index.isdigit() else None
        else:
            values = values.get(part) if isinstance(values, dict) else None
    return values


def all_keys(table: type[Table], prefix: str = "") -> Iterator[str]:
    """Dotted keys of a table and of the tables in it."""
    for key, kind in _types(table).items():
        yield prefix + key
        for member in _members(kind):
            yield from all_keys(member, f"{prefix}{key}.")


@cache
def _types(table: type[Table]) -> dict[str, Any]:
    """Type of each key of a table; kept, because msgspec evaluates the annotations at each call."""
    return {field.name: field.type for field in msgspec.structs.fields(table)}


def _refuse_unknown(
    values: Any, table: type[Table], name: str, prefix: str, whole: type[Table]
) -> None:
    if not isinstance(values, dict):
        return  # wrong type: refused by the conversion
    config = table.__struct_config__
    tag = () if config.tag_field is None else (config.tag_field,)
    fields = _types(table)
    for key, value in values.items():
        if key not in fields and key not in tag:
            allowed = ", ".join((*tag, *fields))
            question = meant(prefix + key, all_keys(whole))
            raise UserError(f"{name}: unknown key {prefix}{key}{question}; allowed here: {allowed}")
        for member in _members(fields.get(key)):
            wanted = member.__struct_config__
            if not wanted.tag_field or (
                isinstance(value, dict) and value.get(wanted.tag_field) == wanted.tag
            ):
                _refuse_unknown(value, member, name, f"{prefix}{key}.", whole)
