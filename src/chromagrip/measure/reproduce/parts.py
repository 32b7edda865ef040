"""The results of the thesis, figure by figure: what it prints beside what comes out here."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ...extras import require
from ...output.folder import prepare
from ...output.rows import Row, report
from .appendix_b import FIGURES
from .figure_16_table_2 import figure_16, object_jobs, table_2
from .figure_17 import figure_17, setting_jobs
from .figures_9_to_11 import figure_9, figure_10, figure_11
from .figures_13_to_15 import figure_13, figure_14, figure_15, validation_jobs
from .page import picture, write_page
from .runs import UNFINISHED, Job, Runs, run_jobs
from .statements import Section
from .sweep import BLUNTER, SWEEP, Variant


@dataclass(frozen=True)
class Plan:
    """How much is run.

    Attributes
    ----------
    quick: no sweep of what is not printed, fewer settings
    camera: scene at whose rate the grasps also go through the camera; None for the truth path only
    """

    quick: bool
    camera: str | None

    @property
    def sweep(self) -> list[Variant]:
        """What is turned of what is not printed."""
        return [] if self.quick else SWEEP

    @property
    def sweep_of_objects(self) -> list[Variant]:
        """The same for Table 2."""
        return [] if self.quick else [*SWEEP, BLUNTER]


def _nothing(plan: Plan) -> list[Job]:
    return []


def _validation(plan: Plan) -> list[Job]:
    return validation_jobs(plan.camera, plan.sweep)


def _sections_of_appendix_b() -> list[Section]:
    sections = []
    for name, make in FIGURES.items():
        verdict, rows, figure = make()
        section = Section(
            part=f"figure-{name}",
            title=verdict.title,
            figure=figure,
            agrees=verdict.agrees,
            sentence=verdict.sentence,
            rows=rows,
        )
        sections.append(section)
    return sections


@dataclass(frozen=True)
class Part:
    """A figure or table: the grasps that it needs, and what it says of them.

    Attributes
    ----------
    sections: made of the runs
    jobs: runs that are summed up
    traced: runs whose trace it draws
    """

    sections: Callable[[Runs, Plan], list[Section]]
    jobs: Callable[[Plan], list[Job]] = _nothing
    traced: Callable[[Plan], list[Job]] = _nothing


PARTS = {
    "figure-9": Part(lambda runs, plan: [figure_9()]),
    "figure-10": Part(lambda runs, plan: [figure_10()]),
    "figure-11": Part(lambda runs, plan: [figure_11()]),
    "figure-13": Part(lambda runs, plan: [figure_13(runs, plan.camera)], traced=_validation),
    "figure-14": Part(
        lambda runs, plan: [figure_14(runs, plan.camera, plan.sweep)], traced=_validation
    ),
    "figure-15": Part(lambda runs, plan: [figure_15(runs, plan.camera)], traced=_validation),
    "figure-16": Part(
        lambda runs, plan: [figure_16(runs)], jobs=lambda plan: object_jobs(None, [])
    ),
    "table-2": Part(
        lambda runs, plan: [table_2(runs, plan.camera, plan.sweep_of_objects)],
        jobs=lambda plan: object_jobs(plan.camera, plan.sweep_of_objects),
    ),
    "figure-17": Part(
        lambda runs, plan: [figure_17(runs, plan.quick, plan.sweep)],
        jobs=lambda plan: setting_jobs(plan.quick, plan.sweep),
    ),
    "appendix-b": Part(lambda runs, plan: _sections_of_appendix_b()),
}


def reproduce(
    parts: list[str],
    plan: Plan,
    out: Path | None,
    force: bool,
    workers: int,
    progress: Callable[[str], None],
) -> tuple[dict[str, Any], list[Section]]:
    """Run what some parts of the thesis need, and compare.

    Interrupted, it goes on where it was when it is called again with the same folder.

    Parameters
    ----------
    parts: keys of PARTS
    plan: how much of each
    out: folder for the page, pictures, traces and tables; None writes nothing
    force: write over what is there
    workers: processes
    progress: told what is being done

    Returns
    -------
    Report of the rows, and a section for each figure or table.
    """
    if out is not None:
        require("data")
        prepare(out, force or (out / UNFINISHED).exists())
    chosen = {name: PARTS[name] for name in parts}
    jobs = [job for part in chosen.values() for job in part.jobs(plan)]
    traced = [job for part in chosen.values() for job in part.traced(plan)]
    runs = run_jobs(jobs, list(dict.fromkeys(traced)), out, workers, progress)
    sections = []
    for name, part in chosen.items():
        progress(name)
        sections += part.sections(runs, plan)
    rows = [row for section in sections for row in rows_of(section)]
    result = report(rows, plan.quick)
    if out is not None:
        _write(sections, result, plan, out)
    return result, sections


def rows_of(section: Section) -> list[Row]:
    """Every figure of a section, those first that the thesis prints."""
    return [check.row() for check in section.checks] + section.rows


def _write(sections: list[Section], result: dict[str, Any], plan: Plan, out: Path) -> None:
    for section in sections:
        (out / f"{section.part}.png").write_bytes(picture(section.figure))
    write_page(sections, result["machine"], plan.quick, plan.camera, out / "index.html")
    listed = [
        {
            "part": section.part,
            "verdict": section.verdict,
            "sentence": section.sentence,
            "rows": [asdict(row) for row in rows_of(section)],
        }
        for section in sections
    ]
    text = json.dumps({**result, "parts": listed}, indent=2, ensure_ascii=False)
    (out / "reproduction.json").write_text(text + "\n", encoding="utf-8")
    if (out / UNFINISHED).exists():
        (out / UNFINISHED).replace(out / "runs.csv")
