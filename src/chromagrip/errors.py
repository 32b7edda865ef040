"""Errors a user can cause: one sentence each, exit code 2 on the command line."""

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches

#: Longest word or quoted value that a message repeats whole [characters].
_LONGEST = 240
_LONG = re.compile(
    rf"(?<!\w)'[^']{{{_LONGEST},}}'|(?<!\w)\"[^\"]{{{_LONGEST},}}\"|\S{{{_LONGEST},}}"
)


class UserError(ValueError):
    """A request that cannot be met; the message says what, where, and what is allowed.

    A message may repeat text from a stranger's file. It is therefore one line of bounded length,
    without control characters.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(str(message)))


def one_line(text: str) -> str:
    """Remove control characters and shorten long values; a second call changes nothing."""
    text = "".join(c if c.isprintable() else _harmless(c) for c in text)
    text = _LONG.sub(_short, text)
    # Longest message, and lengths of the begin and the end kept of a longer one [characters].
    most, begin, end = 1600, 600, 400
    if len(text) > most:
        text = f"{text[:begin]} … {text[-end:]}"
    return text


def _short(found: re.Match[str]) -> str:
    """Begin and end of a long value."""
    value = found[0]
    return f"{value[:100]}…{value[-40:]}"


def _harmless(character: str) -> str:
    """Escape a character that is not printable; a line break or tab becomes a space."""
    return " " if character in "\n\r\t" else ascii(character)[1:-1]


@contextmanager
def located(place: str) -> Iterator[None]:
    """Prefix the message of a `UserError` that is raised inside with the place, once."""
    place = one_line(place)
    try:
        yield
    except UserError as error:
        if str(error).startswith(place):
            raise
        raise type(error)(f"{place}: {error}") from None


def meant(word: str, known: Iterable[str]) -> str:
    """A question that names the known word nearest to an unknown one; "" if none is near.

    Parameters
    ----------
    word: as typed; of a dotted key the last part counts too
    known: words or dotted keys
    """
    words = list(dict.fromkeys(known))
    table, _, last = word.rpartition(".")
    near = [each for each in words if each.rpartition(".")[2] == last and each != word]
    if not near:
        beside = {
            each.rpartition(".")[2]: each for each in words if each.rpartition(".")[0] == table
        }
        begun = last.lstrip("-")
        least = 3  # letters of a beginning that is typed for the whole
        starts = [each for each in beside if len(begun) >= least and each.startswith(last)]
        nearest = (get_close_matches(last, each, n=1, cutoff=0.7) for each in (starts, beside))
        found = next(nearest) or starts or next(nearest)
        near = [beside[each] for each in found]
    return f" (did you mean {' or '.join(near[:2])}?)" if near else ""
