"""The results of the thesis, figure by figure: printed values beside those measured here."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from ...output.cells import unfinished_in
from ...output.figure import png
from ...output.page import write_page
from ...output.report import Report, Table, row_as_json
from .appendix_b import appendix_b
from .figure_16_table_2 import OURS, figure_16, object_jobs, table_2
from .figure_17 import figure_17, setting_jobs
from .figures_9_to_11 import figure_9, figure_10, figure_11
from .figures_13_to_15 import figure_13, figure_14, figure_15, validation_jobs
from .quick import left_out
from .runs import BLUNTER, SWEEP, UNFINISHED, UNPRINTED, Job, Runs, Variant, run_jobs
from .statements import Section


@dataclass(frozen=True)
class Plan:
    """Amount of work.

    Attributes
    ----------
    quick: no sweep of unprinted parameters, fewer settings, see `left_out` for Table 2
    camera: scene at whose rate the grasps also go through the camera; None for the truth path only
    """

    quick: bool
    camera: str | None

    @property
    def sweep(self) -> list[Variant]:
        """Unprinted parameters at other values."""
        return [] if self.quick else SWEEP

    @property
    def sweep_of_objects(self) -> list[Variant]:
        """The same for Table 2."""
        return [] if self.quick else [*SWEEP, BLUNTER]

    @property
    def objects(self) -> list[Job]:
        """Jobs of Table 2."""
        variants = [] if self.quick else [OURS, *self.sweep_of_objects]
        return object_jobs(self.camera, variants, self.quick)


#: Function that makes the sections of each figure or table from the runs.
PARTS: dict[str, Callable[[Runs, Plan], list[Section]]] = {
    "figure-9": lambda runs, plan: [figure_9()],
    "figure-10": lambda runs, plan: [figure_10()],
    "figure-11": lambda runs, plan: [figure_11()],
    "figure-13": lambda runs, plan: [figure_13(runs, plan.camera)],
    "figure-14": lambda runs, plan: [figure_14(runs, plan.camera, plan.sweep)],
    "figure-15": lambda runs, plan: [figure_15(runs, plan.camera)],
    "figure-16": lambda runs, plan: [figure_16(runs)],
    "table-2": lambda runs, plan: [table_2(runs, plan.camera, plan.sweep_of_objects, plan.quick)],
    "figure-17": lambda runs, plan: [figure_17(runs, plan.quick, plan.sweep)],
    "appendix-b": lambda runs, plan: appendix_b(),
}
#: Runs of the parts that need their traces.
_TRACED: dict[str, Callable[[Plan], list[Job]]] = dict.fromkeys(
    ("figure-13", "figure-14", "figure-15"),
    lambda plan: validation_jobs(plan.camera, plan.sweep),
)
#: Runs of the parts that need their results only.
_SUMMED: dict[str, Callable[[Plan], list[Job]]] = {
    "figure-16": lambda plan: object_jobs(None, []),
    "table-2": lambda plan: plan.objects,
    "figure-17": lambda plan: setting_jobs(plan.quick, plan.sweep),
}


def reproduce(
    parts: list[str],
    plan: Plan,
    out: Path | None,
    overwrite: bool,
    workers: int,
    progress: Callable[[str], None],
) -> tuple[Report, list[Section]]:
    """Run the grasps that some parts of the thesis need, and compare.

    After an interruption, another call with the same folder goes on.

    Parameters
    ----------
    parts: keys of PARTS
    plan: amount of work
    out: folder for the page, pictures, traces and tables; None writes nothing
    overwrite: write over what is there
    workers: processes
    progress: called with the name of each step

    Returns
    -------
    Rows with a sentence for each figure or table as notes, and its section.
    """
    with unfinished_in(out, UNFINISHED, overwrite) as unfinished:
        traced = [job for name in parts if name in _TRACED for job in _TRACED[name](plan)]
        summed = [job for name in parts if name in _SUMMED for job in _SUMMED[name](plan)]
        runs = run_jobs(summed, traced, out, workers, progress)
        sections = []
        for name in parts:
            progress(name)
            sections += PARTS[name](runs, plan)
        less = (left_out(plan.camera),) if plan.quick and "table-2" in parts else ()
        verdicts = tuple((s.heading, s.title, s.verdict) for s in sections)
        report = Report(
            rows=tuple(row for section in sections for row in section.rows),
            tables=(Table(("figure", "title", "verdict"), verdicts),),
            notes=tuple(f"{s.heading}: {s.sentence}" for s in sections) + less,
            quick=plan.quick,
        )
        if out is not None and unfinished is not None:
            _write(sections, report, plan, out)
            if unfinished.exists():
                unfinished.replace(out / "runs.csv")
        return report, sections


def _write(sections: list[Section], report: Report, plan: Plan, out: Path) -> None:
    for section in sections:
        (out / f"{section.part}.png").write_bytes(png(section.figure))
    parts = [
        {
            "part": section.part,
            "verdict": section.verdict,
            "sentence": section.sentence,
            "rows": [row_as_json(row) for row in section.rows],
        }
        for section in sections
    ]
    text = json.dumps(report.as_json() | {"parts": parts}, indent=2, ensure_ascii=False)
    (out / "reproduction.json").write_text(text + "\n", encoding="utf-8")
    path = (
        f"dashed lines and rows with its name went through the camera, scene {plan.camera}"
        if plan.camera
        else "nothing went through the camera; --camera adds it"
    )
    less = "Also fewer settings, and no sweep of unprinted parameters. "
    quick = f"{left_out(plan.camera)} {less}" if plan.quick else ""
    introduction = [
        Markup(
            "C. Langens, <i>Controlling grip force by maintaining a constant frictional safety "
            "margin</i>. It prints no data for its figures: the numbers and sentences of its text "
            "are compared, curves by shape only."
        ),
        f"{quick}Truth path at 1 kHz; {path}. Not printed: {UNPRINTED}.",
    ]
    pages = [section.on_page() for section in sections]
    write_page(out / "index.html", "The thesis, reproduced", introduction, pages)
