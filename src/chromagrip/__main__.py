"""Entry point: `chromagrip`, and `python -m chromagrip`."""

import gc
import os
import sys
from contextlib import suppress

with suppress(OSError):  # the working folder may be gone
    if sys.path[:1] in ([""], [os.getcwd()]):  # of python -m: a stranger's file there is no module
        del sys.path[0]

from .cli.ending import end_at_once_on_interrupt, finish, quiet_interrupt


def main() -> None:
    """Run the command line; version and doctor also where a package is missing."""
    end_at_once_on_interrupt()
    sys.unraisablehook = quiet_interrupt
    try:
        finish(_start)
    finally:
        gc.freeze()  # memory is given back as a whole: a last search takes 0.3 s


def _start() -> int | None:
    words = sys.argv[1:]
    if words in (["--version"], ["-V"]):
        from . import __version__

        print(f"chromagrip {__version__}")
        return 0
    if words in (["doctor"], ["doctor", "--json"]):
        from .cli.doctor import report

        return report(json_only=len(words) > 1)
    from . import links
    from .errors import UserError
    from .output import opencv

    problem = links.problem()
    if problem is not None:
        raise UserError(problem)
    found = opencv.problem()
    if found is not None:
        if opencv.loaded_version() is None:
            raise UserError(f"{found[0]}; to mend it: {found[1]}")
        if (notice := opencv.notice(found)) is not None:
            print(f"chromagrip: {notice}", file=sys.stderr, flush=True)
    gc.disable()  # what is imported is no garbage: to look for some takes 0.1 s
    try:
        from .cli.app import run
        from .compiled import announce
    except ImportError as error:
        raise UserError(f"{error}; `chromagrip doctor` names what mends it") from None
    announce()
    gc.freeze()
    gc.enable()
    return run(words)


if __name__ == "__main__":
    main()
