"""Smallest error of Γ that a picture of each design allows: `./run bench limits`."""

from dataclasses import dataclass
from math import inf
from pathlib import Path

from chromagrip.loop.results.expected_error import PictureLimit
from chromagrip.measure.limits.body import BodyLimit, Case
from chromagrip.measure.limits.chain import ChainLimit
from chromagrip.measure.limits.dome.report import DomeLimit
from chromagrip.measure.study import Asked, Results, Study, study
from chromagrip.output.cells import write_cells
from chromagrip.output.page import PageSection
from chromagrip.output.report import Report, Table, number
from chromagrip.scene.scene import Body
from chromagrip.thesis import DESIRED_MARGIN

KINDS: dict[Body, type[BodyLimit]] = {"chain": ChainLimit, "dome": DomeLimit}
FRICTION = 0.5


@dataclass(frozen=True)
class Limited:
    """A design in a body."""

    body: Body
    sensor: str


@study("project", "limits")
def limits_study(asked: Asked) -> Study[Limited, PictureLimit]:
    """Smallest error of Γ that one picture of each design allows, held at the desired margin.

    `picture_limits.csv` of the output belongs to `src/chromagrip/loop/results/`.
    """
    every = [Limited(body, name) for body, kind in KINDS.items() for name in kind.default_designs()]

    def show(results: Results[Limited, PictureLimit], out: Path) -> list[PageSection]:
        write_cells([limit for _, limit in results], out / "picture_limits.csv")
        return []

    return Study(
        settings=every[: 2 if asked.quick else None],
        measure=measure,
        result=PictureLimit,
        report=report,
        show=show,
        words=lambda one: f"{one.sensor}, {one.body}",
    )


def measure(one: Limited) -> PictureLimit:
    """Limits of a design that holds a flat object at the desired margin."""
    kind = KINDS[one.body]
    case = Case(
        body=one.body,
        grip_n=kind.GRIP,
        load_n=(1.0 - DESIRED_MARGIN) * FRICTION * kind.GRIP,
        azimuth_deg=0.0,
        friction=FRICTION,
        radius_mm=inf,
        stiffness_kpa=200.0,
        shears=3,
        noise_levels=2.0,
        frames=1,
        margin_error=None,
    )
    entry = kind.of(case, one.sensor).entry()
    if one.body == "chain":
        bound = entry["limits"]["margin"]
        return PictureLimit(body=one.body, sensor=one.sensor, noise=bound, with_misfit=bound)
    contact = entry["deviations"]["contact"]
    return PictureLimit(
        body=one.body,
        sensor=one.sensor,
        noise=contact["bound"]["margin"],
        with_misfit=contact["bound plus misfit"]["margin"],
    )


def report(results: Results[Limited, PictureLimit]) -> Report:
    """Both limits of each design."""
    lines = [
        (one.sensor, one.body, number(limit.noise, ".2g"), number(limit.with_misfit, ".2g"))
        for one, limit in results
    ]
    header = ("design", "body", "by the noise alone", "with the reader's misfit")
    return Report(rows=(), tables=(Table(header, tuple(lines), keys=2),))
