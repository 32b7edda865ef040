"""Results of the jobs with the code of a checkout, which are kept."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from .digests import Parts, digest, digests
from .jobs import OUT, TREE, Job

#: File of a job's folder with its digests; it is there when the job is whole.
DIGESTS = "digests.json"
#: File with what a job printed as JSON.
PRINTED = "printed.json"
#: A sum depends on the number of threads that share it.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
SCRIPTS = Path(__file__).parent
#: What decides how files are read, as this process has it: the file may be changed meanwhile.
RULES = (SCRIPTS / "digests.py").read_bytes()
#: Folders of a checkout that decide its results.
CODE = ("src", "model", "render", "tracking", "control", "fixtures")
#: Exit code of a command that is refused.
REFUSED = 2


@dataclass(frozen=True)
class Result:
    """Results of a job.

    Attributes
    ----------
    folder: that holds them
    words: that the commit accepted; with a script's text in place of its name
    seconds: of processors that it took
    rules: digest of the rules by which the digests were made
    failed: last line of what it said on stderr, where it failed
    files: digests of its files
    """

    folder: Path
    words: list[str]
    seconds: float
    rules: str = ""
    failed: str = ""
    files: dict[str, Parts] = field(default_factory=dict)


def git(tree: Path, *words: str, **environment: str) -> str:
    """Output of a command of Git in a checkout."""
    command = ["git", "-C", str(tree), *words]
    environ = {**os.environ, **environment}
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=environ)
    return done.stdout.strip()


def commit_of(tree: Path, revision: str) -> str:
    """First ten hex digits of a commit."""
    return git(tree, "rev-parse", "--verify", f"{revision}^{{commit}}")[:10]


def state_of(tree: Path) -> str:
    """Name of the code that a checkout holds, with its changes: a digest of it.

    Two commits with one program, which differ in their documents or tests, have one name.
    """
    with tempfile.TemporaryDirectory() as temporary:
        index = {"GIT_INDEX_FILE": f"{temporary}/index"}
        git(tree, "read-tree", "HEAD", **index)
        git(tree, "add", "--all", **index)
        holds = git(tree, "ls-files", "--stage", "--", *CODE, **index)
    return digest(holds.encode())[:10]


def checkout(tree: Path, commit: str, folder: Path) -> Path:
    """Clone of a checkout at a commit, made once: its kernels take minutes to compile."""
    place = folder / commit
    if not place.exists():
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, suffix=".part") as temporary:
            clone = Path(temporary) / "clone"
            subprocess.run(["git", "clone", "-q", str(tree), str(clone)], check=True)
            git(clone, "checkout", "-q", commit)
            clone.rename(place)
    return place


def kept(job: Job, results: Path) -> Result | None:
    """Result of a job that is in a folder, is whole, and has words that are still its own."""
    folder = results / job.name
    try:
        result = Result(folder, **json.loads((folder / DIGESTS).read_text(encoding="utf-8")))
    except (FileNotFoundError, ValueError):
        return None
    if result.words not in [list(map(_text, words)) for words in job.words]:
        return None
    if result.rules != _rules(job):
        result = replace(result, rules=_rules(job), files=digests(folder, (DIGESTS, *job.ignored)))
        _write(folder, result)
    return result


def compute(job: Job, tree: Path, results: Path, cache: Path) -> Result:
    """Run a job with the code of a checkout and keep its result, but not one that fails.

    It is said in another way only where the first is refused: what breaks is not hidden.

    Parameters
    ----------
    results: folder in which the job gets one
    cache: folder for what the program keeps for its user
    """
    results.mkdir(parents=True, exist_ok=True)
    failures = []
    for words in job.words:
        with tempfile.TemporaryDirectory(dir=results, suffix=".part") as temporary:
            part = Path(temporary) / job.name
            part.mkdir()
            begin = _processor_time()
            code, failed = _run(words, tree, part, cache)
            result = Result(
                results / job.name,
                [_text(word) for word in words],
                round(_processor_time() - begin, 1),
                _rules(job),
                failed,
                {} if failed else digests(part, job.ignored),
            )
            if not failed:
                _keep(part, result)
                return result
        failures.append(result)
        if code != REFUSED:
            return result
    return failures[0]


def _processor_time() -> float:
    """Time of processors that ended processes took [s]."""
    times = os.times()
    return times.children_user + times.children_system


def forget(result: Result) -> None:
    """Keep a result no longer."""
    (result.folder / DIGESTS).unlink(missing_ok=True)


def _keep(part: Path, result: Result) -> None:
    _write(part, result)
    if result.folder.exists():
        result.folder.rename(part.with_name("former"))
    part.rename(result.folder)


def _write(folder: Path, result: Result) -> None:
    """Write the digests of a result, whole or not at all."""
    entries = {name: value for name, value in asdict(result).items() if name != "folder"}
    unfinished = folder / f"{DIGESTS}.part"
    unfinished.write_text(json.dumps(entries, indent=1, ensure_ascii=False), encoding="utf-8")
    unfinished.replace(folder / DIGESTS)


def _rules(job: Job) -> str:
    """Digest of what decides how the files of a job are read."""
    return digest(RULES + json.dumps(job.ignored).encode())


def _run(words: Sequence[str], tree: Path, out: Path, cache: Path) -> tuple[int, str]:
    """Run words: exit code, and the last line of stderr where they fail."""
    first, *others = words
    start = ["-m", first] if first == "chromagrip" else [str(SCRIPTS / first)]
    places = {OUT: str(out), TREE: str(tree)}
    command = [sys.executable, *start, *(places.get(word, word) for word in others)]
    environment = {
        **os.environ,
        **dict.fromkeys(ONE_THREAD, "1"),
        "PYTHONPATH": str(tree / "src"),
        "XDG_CACHE_HOME": str(cache),
        "MPLBACKEND": "Agg",
    }
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as empty:  # -m looks for modules where it starts
        done = subprocess.run(
            command, cwd=empty, env=environment, capture_output=True, text=True, check=False
        )
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if line.strip()]
        return done.returncode, lines[-1] if lines else f"exit code {done.returncode}"
    if "--json" in words:
        (out / PRINTED).write_text(done.stdout, encoding="utf-8")
    return 0, ""


def _text(word: str) -> str:
    """A word, or the text of the script that it names."""
    script = SCRIPTS / word
    return script.read_text(encoding="utf-8") if word.endswith(".py") else word
