"""Errors a user can cause: one sentence each, exit code 2 on the command line."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

#: Longest word, and longest quoted value, that a message repeats whole [characters]; of a longer
#: one this much is kept of its begin and its end.
_LONGEST, _BEGIN, _END = 240, 100, 40
_LONG = re.compile(
    rf"(?<!\w)'[^']{{{_LONGEST},}}'|(?<!\w)\"[^\"]{{{_LONGEST},}}\"|\S{{{_LONGEST},}}"
)
#: Longest message, and what is kept of a longer one [characters].
_MESSAGE, _MESSAGE_BEGIN, _MESSAGE_END = 1600, 600, 400


class UserError(ValueError):
    """A request that cannot be met; the message says what, where, and what is allowed.

    A message repeats what a stranger's file may hold. It is one line of bounded length, in which
    nothing controls a terminal.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(str(message)))


def one_line(text: str) -> str:
    """Text without control characters, in which long values are shortened; twice is as once."""
    text = "".join(c if c.isprintable() else _harmless(c) for c in text)
    text = _LONG.sub(_short, text)
    if len(text) > _MESSAGE:
        text = f"{text[:_MESSAGE_BEGIN]} … {text[-_MESSAGE_END:]}"
    return text


def _short(found: re.Match[str]) -> str:
    value = found[0]
    return f"{value[:_BEGIN]}…{value[-_END:]}"


def _harmless(character: str) -> str:
    """Escape of a character that is not printed; a line break is a space."""
    return " " if character in "\n\r\t" else ascii(character)[1:-1]


@contextmanager
def located(place: str) -> Iterator[None]:
    """Put the place in front of the message of a `UserError` that is raised inside, once."""
    place = one_line(place)
    try:
        yield
    except UserError as error:
        if str(error).startswith(place):
            raise
        raise type(error)(f"{place}: {error}") from None
