"""Entry point: `chromagrip`, and `python -m chromagrip`."""

import sys

from .cli.doctor import report


def main() -> None:
    """Run the command line; the doctor also where a package is missing."""
    if sys.argv[1:] == ["doctor"]:
        sys.exit(report())
    try:
        from .cli.app import main as run
    except ImportError as error:
        print(f"chromagrip: {error}; `chromagrip doctor` names what mends it", file=sys.stderr)
        sys.exit(2)
    run()


if __name__ == "__main__":
    main()
