"""Time of parts of a program, and time and memory of a command in a process of its own."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from chromagrip.errors import UserError

#: Program of the process. It reads its own peak of memory: `wait` would count its parent too.
_PROGRAM = """
import atexit, resource, sys
def tell():
    try:
        with open("/proc/self/status") as status:
            peak = next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
    except OSError:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print("peak", peak, file=sys.stderr)
atexit.register(tell)
from chromagrip.__main__ import main
main()
"""


@contextmanager
def clock(spent: dict[str, float], part: str) -> Iterator[None]:
    """Add the time of what is done within to a part [s]."""
    begin = time.perf_counter()
    yield
    spent[part] += time.perf_counter() - begin


def run_child(words: list[str]) -> tuple[float, float]:
    """Duration [s] and largest memory [MB] of `chromagrip WORDS`.

    Raises
    ------
    UserError
        When it fails.
    """
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-P", "-c", _PROGRAM, *words], capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - begin
    if done.returncode != 0:
        raise UserError(f"chromagrip {' '.join(words)} failed: {done.stderr.strip()[:200]}")
    return seconds, int(done.stderr.split()[-1]) / 1024.0
