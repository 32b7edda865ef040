"""The engine that runs any study: processes, resuming, progress, and the files that it leaves.

The results so far lie in `unfinished.jsonl` of the output folder, one setting a line. The same call
goes on from there. The file is gone when the study is complete.
"""

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args, get_origin

import msgspec
import numpy as np
from markupsafe import Markup

from ..by_name import name_of
from ..errors import UserError
from ..folders import whole_file
from ..output.cells import unfinished_in
from ..output.page import PageSection, write_page
from ..output.processes import map_processes
from ..output.report import Report
from ..strange_files import read_small
from .study import ALL, Asked, Study, find_study

#: Results of a study that is not complete, and the figures of one that is.
UNFINISHED, FIGURES = "unfinished.jsonl", "results.json"
#: Processes by default.
CORES = os.cpu_count() or 1
#: Largest unfinished file that is read [bytes].
_MOST_BYTES = 1 << 29
#: Keeps a result: called with its setting and itself.
Keep = Callable[[Any, Any], None]


def measure(
    verb: str,
    part: str,
    asked: Asked = ALL,
    *,
    out: Path | None = None,
    overwrite: bool = False,
    workers: int = CORES,
    progress: Callable[[str], None] = lambda text: None,
) -> Report:
    """Run a study of the table by its name, such as `measure("bench", "force")`.

    Parameters
    ----------
    verb, part: words of its command
    asked: what is asked of it
    out: folder for results.json, index.html, pictures and tables, in which an interrupted study
        goes on; None writes nothing
    overwrite: write over a finished study
    workers: processes; one measures in this one
    progress: called with the setting that was measured last, and how many are done

    Raises
    ------
    UserError
        When there is no such study, method or part, or the folder cannot be used.
    """
    study = find_study(verb, part, asked).make(asked)
    words = [verb, part, asked.world, *asked.only, *(["quick"] if asked.quick else [])]
    name = " ".join(filter(None, words))
    return replace(run_study(name, study, out, overwrite, workers, progress), quick=asked.quick)


def run_study(
    name: str,
    study: Study[Any, Any],
    out: Path | None = None,
    overwrite: bool = False,
    workers: int = 1,
    progress: Callable[[str], None] = lambda text: None,
) -> Report:
    """Measure every setting of a study that was not measured before; see `measure`.

    Parameters
    ----------
    name: of the study; an unfinished study of another name is refused
    """
    with unfinished_in(out, UNFINISHED, overwrite) as unfinished:
        results = _results(name, study, unfinished, workers, progress)
        report = study.report(results)
        if out is not None and unfinished is not None:
            _write(out, name, report, study.show(results, out))
            unfinished.unlink()
    return report


def _results(
    name: str,
    study: Study[Any, Any],
    unfinished: Path | None,
    workers: int,
    progress: Callable[[str], None],
) -> list[tuple[Any, Any]]:
    """Every setting with its result, in the order of the study."""
    found = dict(_read(unfinished, name, study.result))
    wanted: dict[str, Any] = {}

    def run(settings: Sequence[Any], processes: int, keep: Keep) -> None:
        wanted.update((key_of(one), one) for one in settings)
        todo = [one for one in settings if key_of(one) not in found]
        with closing(map_processes(study.measure, todo, processes, ordered=True)) as results:
            for setting, result in zip(todo, results, strict=True):
                found[key_of(setting)] = result
                keep(setting, result)
                done = sum(key in found for key in wanted)
                progress(f"{study.words(setting)}: {done} of {len(wanted)}")

    def so_far() -> list[tuple[Any, Any]]:
        return [(one, found[key]) for key, one in wanted.items()]

    with _kept(unfinished, name, found) as keep:
        settings = study.settings
        while settings:
            run(settings, workers, keep)
            settings = [one for one in study.more(so_far()) if key_of(one) not in wanted]
        run(study.timed, 1, keep)
    return so_far()


def key_of(setting: Any) -> str:
    """Digest that is the same for equal settings, in every process."""
    text = json.dumps(_plain(setting), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _plain(value: Any) -> Any:
    """Value as JSON can hold it; arrays with their shape, methods by their name."""
    return msgspec.to_builtins(value, enc_hook=_encoded)


def _encoded(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return {"shape": list(value.shape), "values": value.ravel().tolist()}
    return value.item() if isinstance(value, np.generic) else name_of(value)


def _decoded(kind: Any, value: Any) -> Any:
    if get_origin(kind) is not np.ndarray:
        raise NotImplementedError(kind)
    (number,) = get_args(get_args(kind)[1])
    return np.array(value["values"], dtype=number).reshape(value["shape"])


def _line(key: str, result: Any) -> str:
    values = {"setting": key, "result": _plain(result)}
    return json.dumps(values, ensure_ascii=False) + "\n"


@contextmanager
def _kept(path: Path | None, name: str, found: dict[str, Any]) -> Iterator[Keep]:
    """File of the results so far; yields the function that adds one. None keeps nothing."""
    if path is None:
        yield lambda setting, result: None
        return
    with whole_file(path) as part:  # without the line that a kill cut off
        before = (_line(key, result) for key, result in found.items())
        text = "".join([json.dumps({"study": name}) + "\n", *before])
        part.write_text(text, encoding="utf-8")
    with path.open("a", encoding="utf-8") as file:

        def keep(setting: Any, result: Any) -> None:
            file.write(_line(key_of(setting), result))
            file.flush()

        yield keep


def _read(path: Path | None, name: str, kind: Any) -> Iterator[tuple[str, Any]]:
    """Results of an interrupted study by the key of their setting.

    A line that a kill cut off counts as not written.

    Raises
    ------
    UserError
        When the file is of another study, or damaged.
    """
    if path is None or not path.exists():
        return
    try:
        *lines, _ = read_small(path, _MOST_BYTES).decode("utf-8").split("\n")
    except UnicodeDecodeError:
        raise UserError(f"{path} cannot be read as a study; remove it to begin again") from None
    for number, line in enumerate(lines, 1):
        try:
            entry = json.loads(line)
            if number > 1:
                yield entry["setting"], msgspec.convert(entry["result"], kind, dec_hook=_decoded)
            elif entry["study"] != name:
                raise UserError(f"{path.parent} holds an unfinished {entry['study']}, no {name}")
        except UserError:
            raise
        except (KeyError, TypeError, ValueError, RecursionError):
            raise UserError(
                f"{path}, line {number}, is no result of {name}; remove the line or the file, and "
                "it is measured again"
            ) from None


def _write(out: Path, name: str, report: Report, sections: Sequence[PageSection]) -> None:
    """Write the figures, and a page with pictures, tables and notes."""
    text = json.dumps(report.as_json(), indent=2, ensure_ascii=False)
    (out / FIGURES).write_text(text + "\n", encoding="utf-8")
    figures = PageSection(
        anchor="figures",
        name="figures",
        title="Figures",
        picture=Markup(""),
        tables=[t for t in (*report.tables, report.listed(), *report.details) if t.lines],
        notes=report.notes,
    )
    write_page(out / "index.html", f"chromagrip {name}", [], [*sections, figures])
