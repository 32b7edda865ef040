"""What two processes compute has the same bytes, whatever the hashes of their texts.

Digests are not stored, for BLAS of another processor changes the last bits. What was computed
before is in `fixtures`: see `test_written_before` and `render/test_golden`.
"""

import hashlib
import runpy
import shutil
from pathlib import Path

import pytest
from msgspec.structs import replace

import chromagrip
from chromagrip import Result, load_scene, run, scene_names
from chromagrip.dataset.folder import MANIFEST, sequence_name
from chromagrip.dataset.make import make
from chromagrip.dataset.recipe import load_recipe
from chromagrip.output.processes import map_processes
from chromagrip.render import RENDERERS, gl_problem, load_sensor, open_renderer, sensor_names

GOLDEN = Path(__file__).parents[1] / "fixtures/golden/make.py"
TINY = replace(load_recipe("tiny"), sequences=2)
#: Renderers that this machine has.
THERE = [name for name in RENDERERS.entries if name != "pyrender" or gl_problem() is None]


def digest(*parts: bytes) -> str:
    return hashlib.sha256(b"".join(parts)).hexdigest()


def of_run(result: Result) -> str:
    columns = result.trace.columns
    return digest(*(name.encode() + column.tobytes() for name, column in columns.items()))


def of_folder(folder: Path) -> str:
    """Of names and bytes of all files below a folder."""
    files = [f for f in sorted(folder.rglob("*")) if f.is_file()]
    return digest(*(f.relative_to(folder).as_posix().encode() + f.read_bytes() for f in files))


def short(name: str, frames: int, **changes: object) -> Result:
    """Run of the first frames of a scene."""
    rate = load_scene(name).camera.rate_hz
    return run(load_scene(name, {"duration_s": (frames - 0.5) / rate, **changes}))


def of_pictures(name: str) -> str:
    """Of what the camera of a scene takes under grips that grow."""
    taken = []
    with chromagrip.open(name) as rig:
        rig.reset()
        for grip in (1.0, 2.0, 3.0):
            rig.step(grip)
            taken.append(rig.sample(grip).frame.image.tobytes())
    return digest(*taken)


def digests(number: int) -> dict[str, str]:
    """Of what is computed in a short time."""
    found = {
        f"scene {name}": of_run(short(name, 4 if name.startswith("pinch") else 8, path="truth"))
        for name in scene_names()
    }
    for body, name in (("dome", "chromatouch-2022"), ("chain", "margin-60hz")):
        found[f"estimates on a {body}"] = of_run(short(name, 4))
        found[f"pictures of a {body}"] = of_pictures(name)
    drawn = runpy.run_path(str(GOLDEN))
    for name in sensor_names():
        found[f"design {name}"] = digest(drawn["picture"](name).tobytes())
    for name in THERE:
        renderer = open_renderer(name, load_sensor("thesis"))
        found[f"renderer {name}"] = digest(renderer.render(drawn["dented"]("thesis")).tobytes())
        renderer.close()
    return found


@pytest.mark.stages
def test_two_processes_compute_the_same_bytes() -> None:
    one, other = map_processes(digests, [0, 1], workers=2, ordered=True)
    assert one == other
    # They are digests of something.
    assert one["renderer painter"] == one["design thesis"]
    assert len({one[f"design {name}"] for name in sensor_names()}) == len(sensor_names())
    assert of_run(short("margin-60hz", 4, seed=1)) != one["estimates on a chain"]


def test_workers_and_a_resumed_run_make_the_same_dataset(tmp_path: Path) -> None:
    make(TINY, tmp_path / "one")
    found = of_folder(tmp_path / "one")
    make(TINY, tmp_path / "two", workers=2)
    assert of_folder(tmp_path / "two") == found
    (tmp_path / "two" / MANIFEST).unlink()
    shutil.rmtree(tmp_path / "two" / sequence_name(1))
    make(TINY, tmp_path / "two", resume=True)
    assert of_folder(tmp_path / "two") == found
    make(replace(TINY, sequences=1, seed=1), tmp_path / "other")
    assert of_folder(tmp_path / "other" / sequence_name(0)) != of_folder(
        tmp_path / "one" / sequence_name(0)
    )
