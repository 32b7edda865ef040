"""Entry point: `./run bench NAME`, with the options of `chromagrip bench`."""

import sys
from importlib import import_module
from pkgutil import walk_packages

import benchmarks
from chromagrip.cli.app import run_study
from chromagrip.cli.ending import finish


def load() -> None:
    """Import every module here, so that its studies are in the table."""
    for module in walk_packages(benchmarks.__path__, f"{benchmarks.__name__}."):
        if module.name != f"{benchmarks.__name__}.__main__":
            import_module(module.name)


if __name__ == "__main__":
    load()
    finish(lambda: run_study("project", sys.argv[1:], "./run bench"))
