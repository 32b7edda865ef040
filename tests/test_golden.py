"""What is computed again has the same bytes.

Digests are not stored, for BLAS of another processor changes the last bits. What was computed
before is in `fixtures`: see `test_written_before` and `render/test_golden`.
"""

import gc
import hashlib
import runpy
import shutil
from collections.abc import Sequence
from functools import _lru_cache_wrapper
from pathlib import Path

import pytest
from msgspec.structs import replace

import chromagrip
from chromagrip import Result, load_scene, run, scene_names
from chromagrip.dataset.folder import MANIFEST, sequence_name
from chromagrip.dataset.make import make
from chromagrip.dataset.recipe import load_recipe
from chromagrip.render import (
    RENDERERS,
    Membrane,
    gl_problem,
    load_sensor,
    open_renderer,
    sensor_names,
)

GOLDEN = Path(__file__).parents[1] / "fixtures/golden/make.py"
#: A chain and a dome; pinches are among all scenes.
QUICK = ("margin-60hz", "chromatouch-2022")
TINY = replace(load_recipe("tiny"), sequences=2)
#: Rooms whose functions forget what they have computed.
ROOMS = ("model", "render", "tracking", "scene", "sensing")
FORGOTTEN = tuple(f"chromagrip.{room}." for room in ROOMS)


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


def of_pictures(name: str, seed: int | None = None) -> str:
    """Of what the camera of a scene takes under grips that grow."""
    taken = []
    with chromagrip.open(name) as rig:
        rig.reset(seed=seed)
        for grip in (1.0, 2.0):
            rig.step(grip)
            taken.append(rig.sample(grip).frame.image.tobytes())
    return digest(*taken)


def of_renderer(name: str, dented: Membrane) -> str:
    renderer = open_renderer(name, load_sensor("thesis"))
    try:
        return digest(renderer.render(dented).tobytes())
    finally:
        renderer.close()


def forget() -> None:
    """Empty the caches of functions that this process has called."""
    for each in gc.get_objects():
        if isinstance(each, _lru_cache_wrapper) and str(each.__module__).startswith(FORGOTTEN):
            each.cache_clear()


def digests(scenes: Sequence[str]) -> dict[str, str]:
    """Of what is computed in a short time."""
    forget()
    found = {f"scene {name}": of_run(short(name, 4, path="truth")) for name in scenes}
    if len(scenes) > len(QUICK):
        found["estimates on a dome"] = of_run(short("chromatouch-2022", 4))
    for name in ("chromatouch-2022", "margin-60hz"):
        found[f"pictures of {name}"] = of_pictures(name)
    drawn = runpy.run_path(str(GOLDEN))
    for name in sensor_names():
        found[f"design {name}"] = digest(drawn["picture"](name).tobytes())
    return found


@pytest.mark.parametrize("scenes", [QUICK, pytest.param(scene_names(), marks=pytest.mark.stages)])
def test_what_is_computed_again_has_the_same_bytes(scenes: Sequence[str]) -> None:
    first = digests(scenes)
    assert digests(scenes) == first
    assert of_pictures("margin-60hz", seed=1) != first["pictures of margin-60hz"]
    designs = {first[f"design {name}"] for name in sensor_names()}
    assert len(designs) == len(sensor_names())  # they are digests of something


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.stages if name == "pyrender" else ())
        for name in RENDERERS.entries
    ],
)
def test_a_renderer_that_is_opened_again_draws_the_same_bytes(name: str) -> None:
    if name == "pyrender" and (problem := gl_problem()):
        pytest.skip(problem)
    dented = runpy.run_path(str(GOLDEN))["dented"]("thesis")
    assert of_renderer(name, dented) == of_renderer(name, dented)


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
