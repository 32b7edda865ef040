"""What tests of datasets share."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from chromagrip.dataset import card
from chromagrip.dataset.make import make
from chromagrip.dataset.recipe import Recipe, load_recipe
from chromagrip.output.png import encode_png

from .sealing import sealed

DRAWN = card._sheet


@pytest.fixture(scope="session", autouse=True)
def blank_sheets() -> Iterator[None]:
    """Contact sheets, which take a second each, are blank in all datasets but `tiny`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(card, "_sheet", lambda shown: encode_png(np.zeros((1, 1, 3), np.uint8)))
        yield


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny dataset, made by one process; not to be changed."""
    folder = tmp_path_factory.mktemp("data") / "tiny"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(card, "_sheet", DRAWN)
        make(load_recipe("tiny"), folder)
    return folder


@pytest.fixture(scope="session")
def presses() -> Recipe:
    """A press of a dome in two frames, read again, with labels of pixels."""
    scene = {
        "body": "dome", "sensor": "dome-2022", "duration_s": 0.05,
        "camera": {"rate_hz": 20.0, "noise_levels": 1.0},
    }  # fmt: skip
    draw = {
        "motion": {"choice": ["move"]}, "pose.press_share": {"choice": [0.25]},
        "pose.shear_mm": {"choice": [0.5]}, "pose.shear_towards_deg": {"each": [40.0, 200.0]},
        "object.radius_mm": {"each": [12.0, 8.0]}, "object.stiffness_kpa": {"choice": [400.0]},
    }  # fmt: skip
    truth = ("traction", "contact", "depth", "flow")
    return Recipe(sequences=1, reading="auto", scene=scene, draw=draw, truth=truth)


@pytest.fixture(scope="session")
def pressed(tmp_path_factory: pytest.TempPathFactory, presses: Recipe) -> Path:
    """The dataset of `presses`; not to be changed."""
    folder = tmp_path_factory.mktemp("data") / "pressed"
    make(presses, folder)
    return folder


@pytest.fixture(scope="session")
def respelled() -> Callable[..., None]:
    """Replaces a value of a table of the first sequence, and makes the checksums fit."""

    def change(folder: Path, table: str, column: str, frame: int, value: Any) -> None:
        path = folder / "sequence-000000" / f"{table}.parquet"
        found = pq.read_table(path)
        values, where = found[column].to_pylist(), found.column_names.index(column)
        values[frame] = value if table == "frames" else [value] * len(values[frame])
        changed = pa.array(values, found.schema.field(where).type)
        pq.write_table(found.set_column(where, column, changed), path)
        sealed(folder)

    return change
