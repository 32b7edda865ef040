"""Entry point: `chromagrip`, and `python -m chromagrip`."""

import gc
import os
import sys

if sys.path[:1] in ([""], [os.getcwd()]):  # of python -m: a stranger's file there is no module
    del sys.path[0]

from . import links
from .cli.doctor import report


def main() -> None:
    """Run the command line; version and doctor also where a package is missing."""
    words = sys.argv[1:]
    if words in (["--version"], ["-V"]):
        from . import __version__

        print(f"chromagrip {__version__}")
        return
    if words in (["doctor"], ["doctor", "--json"]):
        sys.exit(report(json_only=len(words) > 1))
    _refuse(links.problem())
    gc.disable()  # what is imported is no garbage: to look for some takes 0.1 s
    try:
        from .cli.app import main as run
        from .compiled import announce
    except ImportError as error:
        _refuse(f"{error}; `chromagrip doctor` names what mends it")
    except KeyboardInterrupt:
        print("chromagrip: interrupted", file=sys.stderr)
        sys.exit(130)
    announce()
    gc.freeze()
    gc.enable()
    try:
        run()
    finally:
        gc.freeze()  # memory is given back as a whole: a last search takes 0.3 s


def _refuse(problem: str | None) -> None:
    if problem is not None:
        print(f"chromagrip: {problem}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
