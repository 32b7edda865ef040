"""How a command ends: one sentence and an exit code, whatever happened; a traceback for a bug.

Nothing but the standard library is imported: it guards all other imports too.
"""

import io
import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NoReturn

from ..errors import UserError, one_line

NAME = "chromagrip"
INVALID = 2
INTERRUPTED = 130
CLOSED = 141


def finish(work: Callable[[], int | None]) -> NoReturn:
    """End this process with the exit code of a command.

    Parameters
    ----------
    work: runs it; its exit code, None is 0
    """
    _open_streams()
    code = _flushed(_code(work))
    end_at_once_on_interrupt()  # what is left to do is the interpreter's, and has no handlers
    sys.exit(code)


def refuse(problem: object) -> int:
    """Say why a command is not done, on stderr if there is one; the exit code."""
    with suppress(OSError):
        print(f"{NAME}: {one_line(str(problem))}", file=sys.stderr, flush=True)
    return INVALID


def end_at_once_on_interrupt() -> None:
    """End on Ctrl-C where nothing has to be closed: while modules are loaded, and at the end.

    What is imported may swallow a KeyboardInterrupt, or print it with a traceback.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED))


def _code(work: Callable[[], int | None]) -> int:
    """Exit code of a command; every kind of error that input and machine can cause ends here."""
    try:
        return work() or 0
    except UserError as error:
        return refuse(error)
    except BrokenPipeError:  # the reader is gone, as with `| head`
        return CLOSED
    except KeyboardInterrupt as error:
        number = error.args[0] if error.args else signal.SIGINT
        end_at_once_on_interrupt()
        exec("")  # Python ends by the signal if it came inside of an exec(), unless one follows
        refuse("interrupted" if number == signal.SIGINT else "terminated")
        return 128 + int(number)
    except OSError as error:
        names = [str(name) for name in (error.filename, error.filename2) if name is not None]
        return refuse(f"{' and '.join(names) or 'input or output'}: {error.strerror or error}")
    except MemoryError as error:
        return refuse(f"this needs more memory than there is{f': {error}' if str(error) else ''}")
    except RecursionError:
        return refuse("the input is nested too deeply")
    except UnicodeError as error:
        return refuse(f"text cannot be read or written as {getattr(error, 'encoding', 'text')}")


def _flushed(code: int) -> int:
    """Write what is left for the screen; the exit code if that fails is another one."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        code = CLOSED
    except OSError as error:
        code = code or refuse(f"input or output: {error.strerror}")
    else:
        return code
    # The interpreter tries once more at its end, and must not complain.
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


def _open_streams() -> None:
    """Give a closed stream somewhere to go, and let no letter fail that a terminal lacks."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # else the first file that is opened would take its place
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # Γ is shown as a question mark
            stream.reconfigure(errors="replace")


def quiet_interrupt(unraisable: Any) -> None:
    """Say nothing of a Ctrl-C that came where nothing can be raised; `stop_if_interrupted` asks."""
    if not issubclass(unraisable.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)
