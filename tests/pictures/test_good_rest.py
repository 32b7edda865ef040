"""Rest frames that are unlike the others are left out and named; good ones are not."""

import functools
import json
import re
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial import KDTree

from chromagrip.pictures.good_rest import unlike
from chromagrip.pictures.track import track_source
from chromagrip.render import Frame
from chromagrip.tracking import Tracks

from .drawn_dots import save

Typed = Callable[..., CompletedProcess[str]]


@functools.cache
def clean(
    shift: float = 0.0, radius: float = 5.0, pitch: int = 24, contrast: float = 0.7
) -> np.ndarray:
    """Dark dots on a shaded ground, moved to the right, without noise (120, 160)."""
    y, x = np.mgrid[:120, :160]
    places = np.stack(np.meshgrid(np.arange(16, 150, pitch), np.arange(16, 112, pitch)), -1)
    places = places + np.random.default_rng(pitch).uniform(-2.0, 2.0, places.shape)
    far = KDTree(places.reshape(-1, 2) + np.array([shift, 0.0])).query(np.stack([x, y], -1))[0]
    covered = contrast / (1.0 + np.exp((far - radius) / 0.6))
    return np.asarray((210.0 - 0.3 * x) * (1.0 - covered))


def shot(grey: np.ndarray, rng: np.random.Generator, noise: float = 2.0) -> np.ndarray:
    """Picture with noise, RGB."""
    noisy = rng.normal(grey[..., None], noise, (*grey.shape, 3))
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


FAULTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "black": lambda grey: 0.0 * grey + 2.0,
    "grey": lambda grey: 0.0 * grey + 128.0,
    "dark": lambda grey: 0.3 * grey,
    "blurred": lambda grey: cv2.GaussianBlur(grey, (0, 0), 5.0),
    # The lower third as it is in a frame shifted by 11 pixels.
    "torn": lambda grey: np.vstack([grey[:80], np.roll(grey, 11, axis=1)[80:]]),
    "covered": lambda grey: np.where(np.arange(160) < 80, grey, 70.0),  # by a thumb
    "moved": lambda grey: np.roll(grey, 9, axis=1),
    "moved a little": lambda grey: clean(2.0),
}


@pytest.mark.parametrize(
    ("fault", "count", "at"),
    [*((fault, 3, 1) for fault in FAULTS), *((fault, 8, 0) for fault in FAULTS), ("dark", 40, 39)],
)
def test_a_bad_frame_is_named(fault: str, count: int, at: int) -> None:
    rng = np.random.default_rng(count + at)
    frames = [shot(FAULTS[fault](clean()) if k == at else clean(), rng) for k in range(count)]
    found = unlike(frames)
    assert list(found) == [at]
    assert found[at].startswith("unlike the others in ")


def test_good_frames_are_kept() -> None:
    """Of 100 with any noise, contrast and size, and a slow drift, none is left out."""
    rng, frames, left_out = np.random.default_rng(7), 0, 0
    while frames < 100:
        count, noise = int(rng.integers(2, 9)), rng.uniform(0.3, 25.0)
        drift = rng.choice([0.0, 0.3])
        radius, pitch = ((2.0, 14), (3.5, 16), (6.0, 30))[rng.integers(3)]
        contrast = float(rng.choice([0.03, 0.1, 0.7]))
        light = rng.uniform(0.85, 1.0, count)
        pictures = [
            shot(light[k] * clean(drift * k, radius, pitch, contrast)[:96, :120], rng, noise)
            for k in range(count)
        ]
        left_out += len(unlike(pictures))
        frames += count
    assert left_out == 0


def test_what_moves_beside_the_sensor_does_not_count() -> None:
    rng, field = np.random.default_rng(4), np.arange(160) < np.full((120, 1), 100)
    frames = [shot(np.where(field, clean(), np.roll(clean(), 9 * k)), rng) for k in range(5)]
    assert len(unlike(frames)) > 0
    assert unlike(frames, field) == {}


def write(folder: Path, images: list[np.ndarray]) -> str:
    for k, image in enumerate(images):
        save(folder / f"shot-{k}.png", image)
    return str(folder)


@pytest.mark.usefixtures("undrawn")
def test_followed_means_one_thing(typed: Typed, tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    images = [shot(clean(), rng) for _ in range(9)]
    images[0][:], images[3] = 1, shot(FAULTS["covered"](clean()), rng)
    write(tmp_path / "shots", images)
    words = ("track", "first:8", "shots", "--palette", "dark-dots", "--tracker", "fit")
    done = typed(*words, "--out", "out")
    assert done.returncode == 0, done.stderr
    said = " ".join(done.stdout.split())
    assert "first 8 frames of the source, 2 of them left out" in said
    assert "left out at rest frame 0 of shots (shot-0.png): unlike the others in 100%" in said
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    left_out = summary["rest_left_out"]
    assert [each["frame"] for each in left_out] == [0, 3]
    assert left_out[1]["name"] == "frame 3 of shots (shot-3.png)"
    assert re.match(r"unlike the others in [456]\d% of it", left_out[1]["because"])
    table = pq.read_table(tmp_path / "out/tracks.parquet").to_pydict()
    at_rest = np.isfinite(np.array(table["rest_x_px"], dtype=float))
    assert not (np.array(table["visible"]) & ~at_rest).any()
    followed = summary["layers"]["dark"]["markers"]
    assert at_rest.sum() == followed * 9 == 24 * 9
    assert summary["not_followed"] == []


class Late:
    """Knows no place at rest of its second marker, and gives places later."""

    state: object = None

    def __init__(self, palette: object, noise: float) -> None: ...

    def reset(self, rest: object) -> Tracks:
        return Tracks.of_positions(0.0, np.array([[[9.0, 9.0], [np.nan, np.nan]]]))

    def update(self, frame: Frame) -> Tracks:
        return Tracks.of_positions(frame.time, np.array([[[9.0, 8.0], [50.0, 40.0]]]))


@pytest.mark.usefixtures("undrawn")
def test_markers_that_a_tracker_finds_later_are_not_followed(tmp_path: Path) -> None:
    rng, out = np.random.default_rng(6), tmp_path / "out"
    shots = write(tmp_path / "shots", [shot(clean(), rng) for _ in range(2)])
    found = track_source("first", shots, palette="dark-dots", tracker=Late, out=out).summary
    assert found["layers"]["dark"]["markers"] == 1
    table = pq.read_table(out / "tracks.parquet").to_pydict()
    assert table["visible"] == [True, False] * 2
    assert table["x_px"] == table["rest_x_px"] == [9.0, None] * 2
    assert table["last_seen_s"][1::2] == [None, None]


def test_fewer_than_half_good_ones_are_refused(typed: Typed, tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    good, bad = ([shot(grey, rng) for _ in range(5)] for grey in (clean(), 0.0 * clean()))
    half, fewer = write(tmp_path / "a", bad[1:] + good[1:]), write(tmp_path / "b", bad + good[2:])
    words = (write(tmp_path / "shots", good[:1]), "--palette", "dark-dots", "--json")
    assert len(json.loads(typed("track", half, *words).stdout)["rest_left_out"]) == 4
    done = typed("track", fewer, *words)
    assert done.returncode == 2
    assert done.stderr.startswith(f"chromagrip: rest {fewer}: only 3 of 8 rest frames are alike")
    assert done.stderr.count("\n") == 1
