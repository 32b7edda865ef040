"""Compare what this checkout computes with what another commit computes, byte by byte.

    .venv/bin/python tests/compare_commits.py REVISION [--tier quick] [--keep FOLDER]

Every job of `compared/jobs.py` is run with the code of both: runs, recordings, datasets, golden
pictures and what the measuring commands print. A line for each column, key, row or picture that
differs. Exit code 1 when anything differs. Results are kept in FOLDER by the code that made them,
and are computed once; an interrupted comparison goes on, with the job that was interrupted anew.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from compared.computing import Result, checkout, commit_of, compute, forget, kept, state_of
from compared.differences import CHANGED, GONE, NEW, Difference, differences
from compared.jobs import JOBS, Job

ROOT = Path(__file__).resolve().parents[1]
#: So many differences of a job are printed, what is new last.
MOST = 30


def results_of(jobs: Sequence[Job], tree: Path, results: Path, cache: Path) -> Iterator[Result]:
    """Results of jobs with the code of a checkout, in a folder of its state; a line for each."""
    state, took = state_of(tree), 0.0
    for number, job in enumerate(jobs, 1):
        result = kept(job, results)
        how = "kept"
        if result is None:
            result = compute(job, tree, results, cache)
            how = f"fails: {result.failed}" if result.failed else f"{result.seconds:.0f} s"
            if state_of(tree) != state:
                forget(result)
                sys.exit(f"{tree} was changed while {job.name} ran; compare it again")
        took += result.seconds
        print(f"{results.name}  {number}/{len(jobs)}  {job.name}  {how}", flush=True)
        yield result
    print(f"{results.name}  {took / 60:.1f} min of a processor for {len(jobs)} jobs", flush=True)


def compared(old: Iterable[Result], new: Iterable[Result]) -> list[Difference]:
    """Differences of all jobs, each printed as soon as both are there; of many only the first."""
    found = []
    for one, other in zip(old, new, strict=True):
        name = one.folder.name
        if one.words != other.words:
            print(f"said otherwise  {name}: {' '.join(one.words)} and {' '.join(other.words)}")
        its = sorted(differences(one, other), key=lambda each: each.kind == NEW)
        for difference in its[:MOST]:
            print(difference, flush=True)
        if len(its) > MOST:
            print(f"… {name}: {len(its) - MOST} more")
        found += its
    return found


@contextmanager
def folder_or_temporary(folder: Path | None) -> Iterator[Path]:
    """A folder that is kept, or one for now."""
    if folder is not None:
        yield folder.absolute()
        return
    with tempfile.TemporaryDirectory() as temporary:
        yield Path(temporary)


def main(words: Sequence[str] | None = None) -> int:
    """Compare a checkout with a revision; print and count what differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("revision", help="commit to compare with")
    parser.add_argument("--tier", choices=("quick", "whole"), default="whole")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="jobs, instead of a tier")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep all results here")
    parser.add_argument("--here", type=Path, default=ROOT, help="another checkout than this one")
    parser.add_argument("--allow-new", action="store_true", help="what only --here has is no fault")
    asked = parser.parse_args(words)
    names = asked.only or [job.name for job in JOBS if job.quick or asked.tier == "whole"]
    if unknown := sorted(set(names) - {job.name for job in JOBS}):
        parser.error(f"no job {unknown[0]}; there are {', '.join(job.name for job in JOBS)}")
    jobs = [job for job in JOBS if job.name in names]
    here = asked.here.resolve()
    commit = commit_of(here, asked.revision)
    with folder_or_temporary(asked.keep) as folder:
        tree = checkout(here, commit, folder / "trees")
        caches = folder / "caches"
        first, second = state_of(tree), state_of(here)
        second += "-again" if first == second else ""  # with itself: what is not the same twice
        print(f"{first} is {commit}, {second} is {here}", flush=True)
        old = results_of(jobs, tree, folder / first, caches / first)
        new = results_of(jobs, here, folder / second, caches / second)
        found = compared(old, new)
    count = {kind: sum(each.kind == kind for each in found) for kind in (CHANGED, NEW, GONE)}
    print(", ".join(f"{number} {kind}" for kind, number in count.items()) + f" in {len(jobs)} jobs")
    allowed = count[NEW] if asked.allow_new else 0
    return 1 if len(found) > allowed else 0


if __name__ == "__main__":
    sys.exit(main())
