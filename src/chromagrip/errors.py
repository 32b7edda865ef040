"""Errors a user can cause: one sentence each, exit code 2 on the command line."""

from collections.abc import Iterator
from contextlib import contextmanager


class UserError(ValueError):
    """A request that cannot be met; the message says what, where, and what is allowed."""


@contextmanager
def located(place: str) -> Iterator[None]:
    """Put the place in front of the message of a `UserError` that is raised inside, once."""
    try:
        yield
    except UserError as error:
        if str(error).startswith(place):
            raise
        raise type(error)(f"{place}: {error}") from None
