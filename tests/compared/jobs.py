"""What is computed in both commits: names and words of the jobs."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

#: Places that stand in the words of a job: its folder, and the checkout that runs it.
OUT, TREE = "OUT", "TREE"


@dataclass(frozen=True)
class Job:
    """A command that is run with the code of a commit.

    Attributes
    ----------
    name: of the job and of its folder
    words: a list of words for each way to say it; the first that a commit accepts counts, for words
        may differ between two commits. The first word is `chromagrip`, or a script of this folder.
    quick: whether it is of the tier that is run with every commit
    ignored: files that are never the same twice, as patterns
    """

    name: str
    words: tuple[tuple[str, ...], ...]
    quick: bool = False
    ignored: tuple[str, ...] = ()


def job(
    name: str, *ways: str, quick: bool = False, ignored: tuple[str, ...] = (), to: str = OUT
) -> Job:
    """Job of the command `chromagrip`.

    Parameters
    ----------
    name: of the job
    ways: words after `chromagrip`, in each way to say it
    quick, ignored: as of `Job`
    to: folder that it fills, empty where it only prints
    """
    end = ["--out", to] if to else []
    words = tuple(("chromagrip", *way.split(), *end) for way in ways)
    return Job(name, words, quick, ignored)


def _runs() -> Iterable[Job]:
    """Runs of every body on both paths, the camera for .3 s."""
    short = "--path camera --set duration_s=0.3"
    for scene in ("dome-1", "chromatouch-2022", "pinch-lift", "pinch-fill"):
        yield job(f"{scene}-truth", f"grasp --scene {scene} --path truth", quick=True)
        yield job(f"{scene}-camera", f"grasp --scene {scene} {short}", quick=True)
    yield job("margin-60hz-camera", f"grasp --scene margin-60hz {short}", quick=True)
    yield job("ramp-1-truth", "grasp --scene ramp-1 --path truth", quick=True)
    drops = "--set camera.dropped=0.2 --set camera.late=0.2"
    yield job(
        "pinch-fill-late",
        f"grasp --scene pinch-fill --path truth --set duration_s=0.4 {drops}",
        quick=True,
    )
    yield job(
        "pinch-lift-noise",
        "grasp --scene pinch-lift --path truth --set duration_s=0.6 --set truth.margin_noise=0.02",
        quick=True,
    )
    logged = f"grasp --scene chromatouch-2022 {short} --frames png --log mcap"
    yield job("chromatouch-2022-log", logged)
    for scene in ("camera-100hz", "margin-60hz", "ramp-1", "patchy-1", "worn-1"):
        grasp = f"grasp --scene {scene}"
        if scene != "ramp-1":
            yield job(f"{scene}-truth", f"{grasp} --path truth")
        yield job(f"{scene}-painter", f"{grasp} --path camera")
        yield job(f"{scene}-pyrender", f"{grasp} --path camera --renderer pyrender")


def _others() -> Iterable[Job]:
    """Live recordings, datasets, golden pictures, and limits."""
    for scene in ("margin-60hz", "dome-1"):
        yield Job(f"live-{scene}", (("live_recording.py", scene, OUT),), quick=True)
    yield Job("golden", (("golden.py", TREE, OUT),), quick=True)
    yield job("tiny", "dataset make tiny --workers 1", quick=True)
    for recipe in ("contact-3d", "twist", "edges"):
        make = f"dataset make {recipe} --n 1 --workers 1"
        yield job(recipe, make, quick=recipe == "contact-3d")
    yield job("readings", "dataset make contact-3d --n 1 --reading auto --workers 1")
    yield job("limit", "limit --json", quick=True)
    yield job("limit-dome", "limit --body dome --json")


def _measurements() -> Iterable[Job]:
    """Quick runs of the commands that measure."""
    yield job("bench-loop", "bench loop --quick --json", to="")
    yield job("bench-loop-dome", "bench loop --world dome --quick --json", to="")
    yield job("bench-control", "bench control --quick --json", to="")
    yield job("bench-control-pinch", "bench control --world pinch --quick --json", to="")
    for part in ("track", "force"):
        yield job(f"bench-{part}", f"bench {part} --quick --json", to="")
    for world in ("beyond", "dome"):
        yield job(f"bench-force-{world}", f"bench force --world {world} --quick --json", to="")
    for part in ("track", "force", "loop"):
        drawn = ("*.png", "*.svg", "index.html")  # speeds are drawn in all of them
        yield job(f"chart-{part}", f"chart {part} --quick --json", ignored=drawn)
    yield job("stability-track", "stability track --quick --json", quick=True)
    yield job("stability-force", "stability force --quick --json --workers 1")
    yield job("stability-loop", "stability loop --quick --json --workers 1")
    for world in ("dome", "pinch"):
        words = f"stability loop --world {world} --quick --json --workers 1"
        yield job(f"stability-loop-{world}", words)
    yield job("reproduce", "reproduce --quick --json --workers 1")
    yield job("reproduce-appendix-b", "reproduce appendix-b --json --workers 1")


#: Every job, in the order in which they are run.
JOBS: Sequence[Job] = tuple(
    sorted([*_runs(), *_others(), *_measurements()], key=lambda each: not each.quick)
)
