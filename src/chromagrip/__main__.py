"""Entry point: `chromagrip`, and `python -m chromagrip`."""

import sys

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
    try:
        from .cli.app import main as run
        from .compiled import announce
    except ImportError as error:
        _refuse(f"{error}; `chromagrip doctor` names what mends it")
    announce()
    run()


def _refuse(problem: str | None) -> None:
    if problem is not None:
        print(f"chromagrip: {problem}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
