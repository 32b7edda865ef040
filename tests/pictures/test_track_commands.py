import functools
import json
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any
from unittest.mock import Mock

import av
import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial import KDTree

from chromagrip.model import Fingertip
from chromagrip.output.parquet import TRACKS
from chromagrip.pictures.noise_level import noise_level
from chromagrip.pictures.overlay import MAGNIFY, Magnification
from chromagrip.pictures.track import track_source
from chromagrip.render import Frame, Membrane, MembraneMap, add_noise, load_sensor, open_renderer
from chromagrip.render.outlines import areas, centroids, outlines
from chromagrip.sensing import reader
from chromagrip.tracking import Tracks, load_palette
from chromagrip.tracking.baselines.detected import DetectedMarkers

from .drawn_dots import covered, levels, save, spread

Typed = Callable[..., CompletedProcess[str]]
SENSOR = load_sensor("thesis")
PAINTER = open_renderer("painter", SENSOR)
REST = MembraneMap(SENSOR, 251)(np.zeros((Fingertip().nodes, 2)))
#: Dark dots, not in a row so that no two are alike [px].
DOTS = np.stack(np.meshgrid(np.arange(25, 190, 30), np.arange(25, 140, 30)), -1).reshape(-1, 2)
DOTS = DOTS + np.random.default_rng(5).uniform(-3.0, 3.0, DOTS.shape)
DARK = ("--palette", "dark-dots", "--tracker", "detect")
#: Places of the outer layer's dots, beside which the inner one's lie [px].
PAIRS, BESIDE = spread(240, 200, 34.0), np.array([1.0, -0.5])


@functools.cache
def dots(shift: float = 0.0, index: int = 0) -> np.ndarray:
    """Dark dots of radius 6, moved rightwards, on a shaded ground, with noise 1; RGB."""
    cover = covered((200, 150), DOTS + np.array([shift, 0.0]), np.full(len(DOTS), 6.0))
    light = (0.75 - 0.2 * np.arange(200) / 200) * (1.0 - 0.85 * cover)
    return levels(np.repeat(light[..., None], 3, axis=2), 1.0, index)


def pairs(shift: float, index: int) -> np.ndarray:
    """Dots of two layers with noise 2, the outer ones moved rightwards [px]; RGB."""
    light = np.full((200, 240, 3), 0.85)
    palette = load_palette("chromatouch")
    for at, dye in zip(layer_places(shift), palette.transmittance, strict=True):
        light *= 1.0 - covered((240, 200), at, np.full(len(at), 7.0))[..., None] * (1.0 - dye)
    return levels(light, 2.0, index)


def layer_places(shift: float) -> tuple[np.ndarray, np.ndarray]:
    return PAIRS + np.array([shift, 0.0]), PAIRS + BESIDE


def read(out: Path) -> tuple[dict[str, Any], dict[str, np.ndarray], Any]:
    """Summary, columns and schema of a folder."""
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    table = pq.read_table(out / "tracks.parquet")
    columns = {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}
    return summary, columns, table.schema


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """H.264 at 50 Hz."""
    path = tmp_path_factory.mktemp("film") / "dots.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=50)
        stream.height, stream.width, stream.pix_fmt = 150, 200, "yuv444p"
        stream.options = {"crf": "4", "preset": "ultrafast", "g": "1"}
        frames = [av.VideoFrame.from_ndarray(dots(0.5 * k, k), format="rgb24") for k in range(6)]
        for packet in [*(p for frame in frames for p in stream.encode(frame)), *stream.encode()]:
            container.mux(packet)
    return path


def test_detect_lists_both_layers(tmp_path: Path, typed: Typed) -> None:
    """The outer one of a fingertip is moved along x."""
    centres = REST.centres.copy()
    centres[0, :, 0] += 8e-5
    out, membrane = tmp_path / "seen.png", Membrane(centres=centres, axes=REST.axes)
    image = PAINTER.render(membrane)
    add_noise(image, 2.0, 3, 0)
    picture = save(tmp_path / "dome.png", image)
    report = json.loads(typed("detect", picture, "--json", "--out", out).stdout)
    assert (report["width_px"], report["height_px"]) == (640, 480)
    truth = centroids(outlines(membrane, SENSOR.view), square=False)
    true_area = areas(outlines(membrane, SENSOR.view), square=False)
    numbers = []
    for k, name in enumerate(("magenta", "yellow")):
        rows = [row for row in report["markers"] if row["layer"] == name]
        distance, number = KDTree(truth[k]).query([(row["x_px"], row["y_px"]) for row in rows])
        assert sorted(number) == list(range(400))
        assert np.sqrt((distance**2).mean()) < 0.25
        area = np.array([row["area_px2"] for row in rows])
        assert np.median(area / true_area[k, number]) == pytest.approx(1.0, abs=0.05)
        numbers.append({row["pair"]: n for row, n in zip(rows, number, strict=True)})
    # A pair is one marker of the design, moved apart by up to 1.5 px.
    assert None not in numbers[0]
    assert numbers[0] == numbers[1]
    assert np.asarray(cv2.imread(str(out))).shape[1] == 1280


def test_the_palette_that_was_found_finds_the_same_again(tmp_path: Path, typed: Typed) -> None:
    picture, saved = save(tmp_path / "dots.png", dots()), tmp_path / "mine.toml"
    found = json.loads(typed("detect", picture, "--save-palette", saved, "--json").stdout)
    again = json.loads(typed("detect", picture, "--palette", saved, "--json").stdout)
    told = typed("detect", picture, "--palette", "dark-dots").stdout
    layer, count = told.splitlines()[-2].split()[:2]
    assert (layer, int(count)) == ("dark", len(DOTS))
    assert (found["palette"], again["palette"]) == ("auto", str(saved))
    assert found["dyes"]["dark"] == pytest.approx(again["dyes"]["dark"], rel=1e-3)
    assert found["dyes"]["dark"] == pytest.approx([0.15] * 3, abs=0.04)
    places = [[(m["x_px"], m["y_px"]) for m in one["markers"]] for one in (found, again)]
    assert np.max(KDTree(places[0]).query(DOTS)[0]) < 0.3
    np.testing.assert_allclose(places[0], places[1], atol=0.02)


def test_tracks_are_where_the_markers_are(tmp_path: Path, typed: Typed) -> None:
    """Two rest frames and four of a shear, the third with a finger on the lens.

    frame-10 comes after frame-9, and eight frame times after frame-2.
    """
    for k in range(2):
        save(tmp_path / "rest" / f"{k}.png", pairs(0.0, 100 + k))
    for k, number in enumerate((1, 2, 9, 10)):
        image = pairs(0.4 * k, k)
        if k == 2:
            image[85:120, 85:155] = 128
        save(tmp_path / "frames" / f"frame-{number}.png", image)
    (tmp_path / "frames" / "notes.txt").write_text("not a picture", encoding="utf-8")
    words = ("track", "rest", "frames", "--palette", "chromatouch", "--fps", 50, "--json")
    told = json.loads(typed(*words, "--out", "out").stdout)
    summary, columns, schema = read(tmp_path / "out")
    assert told == summary
    assert summary["format"] == "chromagrip track 1"
    assert (summary["frames"], summary["fps"], summary["complete"]) == (4, 50.0, True)
    assert summary["noise_levels"] == pytest.approx(2.0, rel=0.05)
    assert list(columns) == list(TRACKS) == schema.names
    assert {k.decode() for k in schema.metadata} >= set(TRACKS)
    assert len(columns["frame"]) == 4 * 2 * len(PAIRS)
    times = np.array([0.0, 0.02, 0.16, 0.18])
    np.testing.assert_allclose(columns["time_s"], times[columns["frame"]])
    truth = np.stack([layer_places(0.4 * k) for k in range(4)])
    at = np.stack([columns["x_px"], columns["y_px"]], axis=-1)
    for k, name in enumerate(("magenta", "yellow")):
        of_layer = columns["layer"] == name
        # Which drawn dot a number is, by its place in the first frame.
        number = KDTree(truth[0, k]).query(at[of_layer & (columns["frame"] == 0)])[1]
        assert sorted(number) == list(range(len(PAIRS)))
        drawn = number[columns["marker"][of_layer]]
        expected = truth[columns["frame"][of_layer], k, drawn]
        error = at[of_layer] - expected
        seen = columns["visible"][of_layer]
        assert (np.isnan(error).any(axis=1) == ~seen).all()
        # Layers of so few pixels pull on each other; the contract of trackers has the exact bounds.
        assert np.sqrt((error[seen] ** 2).mean()) < 0.25
        rest = np.stack([columns["rest_x_px"], columns["rest_y_px"]], axis=-1)[of_layer]
        np.testing.assert_allclose(rest, truth[0, k, drawn], atol=0.4)
        x, y = expected.T
        under = (x > 92) & (x < 148) & (y > 92) & (y < 113) & (columns["frame"][of_layer] == 2)
        assert under.sum() == 2
        assert not seen[under].any()
        assert seen[~under].mean() > 0.98
        np.testing.assert_allclose(columns["last_seen_s"][of_layer][under], 1 / 50.0)
        share = summary["layers"][name]
        assert share == {"markers": len(PAIRS), "visible_share": pytest.approx(seen.mean())}
    with av.open(str(tmp_path / "out" / "overlay.mp4")) as video:
        pictures = [p.to_ndarray(format="rgb24").astype(int) for p in video.decode(video=0)]
    assert len(pictures) == 4
    assert pictures[0].shape[1] == 1280
    # Red crosses over the finger, and only there.
    red = [(abs(p - (215, 25, 30)).max(axis=2) < 30).sum() for p in pictures]
    assert red[2] - red[1] > 100


@pytest.mark.usefixtures("undrawn")
def test_a_video_has_its_own_times_or_those_given(
    film: Path, tmp_path: Path, typed: Typed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows are written as they come: memory does not wait for the end."""
    monkeypatch.setattr("chromagrip.output.parquet._TRACK_GROUP", 2 * len(DOTS))
    for rate, frames, ended, *options in (
        (50.0, 6, "end of the source"),
        (200.0, 3, "after 3 frames, as asked", "--fps", 200, "--frames", 3),
    ):
        out = tmp_path / f"{rate}"
        assert typed("track", "first:1", film, *DARK, *options, "--out", out).returncode == 0
        summary, columns, _ = read(out)
        assert (summary["frames"], summary["fps"], summary["ended"]) == (frames, rate, ended)
        assert summary["complete"]
        np.testing.assert_allclose(columns["time_s"], columns["frame"] / rate, atol=1e-6)
        x = columns["x_px"].reshape(frames, len(DOTS))
        np.testing.assert_allclose((x - x[0]).mean(axis=1), 0.5 * np.arange(frames), atol=0.02)
        groups = pq.ParquetFile(out / "tracks.parquet").num_row_groups
        assert groups == (frames + 1) // 2


class Endless:
    """Gives dots without end, as a camera does."""

    count = 0

    def read(self) -> tuple[np.ndarray, float]:
        self.count += 1
        return dots(index=self.count), 0.02 * self.count


class Nothing:
    """A tracker that gives none."""

    def __init__(self, palette: object, noise: float) -> None: ...
    def reset(self, rest: object) -> None: ...
    def update(self, frame: object) -> None: ...


@pytest.mark.usefixtures("undrawn")
def test_an_interruption_keeps_what_there_is_and_is_the_end_of_a_camera(
    film: Path, tmp_path: Path, typed: Typed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mine", sys.modules[__name__])
    for name, code, *words in (
        ("film", 130, film),
        ("camera", 0, "mine:Endless"),
        ("limited", 130, "mine:Endless", "--frames", 9),
    ):
        interrupted = Mock(side_effect=[None, None, None, KeyboardInterrupt])  # as Ctrl-C does
        monkeypatch.setattr(reader, "check_tracks", interrupted)
        assert typed("track", "first:2", *words, *DARK, "--out", name).returncode == code
        summary, columns, _ = read(tmp_path / name)
        assert (summary["frames"], summary["complete"]) == (3, code == 0)
        assert summary["ended"] == "interrupted" or code == 0
        assert columns["frame"].max() == 2
        assert (np.diff(columns["time_s"][:: len(DOTS)]) > 0.0).all()


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("error", [SystemExit(0), ValueError("a bug")])
def test_a_tracker_that_fails_keeps_what_it_gave(
    error: BaseException, film: Path, tmp_path: Path
) -> None:
    """An exit is not the end of the program, which would look like success; a bug is shown."""

    class Failing(DetectedMarkers):
        def update(self, frame: Frame) -> Tracks:
            if frame.time > 0.03:
                raise error
            return super().update(frame)

    told = "ValueError: a bug"
    words: dict[str, Any] = {"palette": "dark-dots", "tracker": Failing, "out": tmp_path}
    if isinstance(error, ValueError):
        with pytest.raises(ValueError, match="a bug"):
            track_source("first", str(film), **words)
    else:
        told = str(track_source("first", str(film), **words).broken)
        place = r"\(test_track_commands.py, line \d+\)"
        assert re.match(rf"tracker '.*Failing' failed: SystemExit: 0 {place}; .* 2 frames", told)
    summary, columns, _ = read(tmp_path)
    assert (summary["frames"], summary["complete"], summary["ended"]) == (2, False, told)
    assert columns["frame"].max() == 1


def test_auto_finds_the_frame_at_rest(tmp_path: Path, typed: Typed) -> None:
    for k, shift in enumerate((2.5, BESIDE[0], -0.5)):
        save(tmp_path / "frames" / f"{k}.png", pairs(shift, k))
    words = ("--palette", "chromatouch", "--tracker", "detect", "--json")
    told = json.loads(typed("track", "auto", "frames", *words).stdout)
    assert told["rest"] == "frame 1 of the source, found"


def test_another_sensor_s_pictures_are_doubted(tmp_path: Path, typed: Typed) -> None:
    """Not a finger that covers most of the sensor later. The rest frame is a frame, too."""
    hidden = dots().copy()
    hidden[:, 70:] = 200
    rest = save(tmp_path / "frames" / "last.png", dots())
    for folder, shown in (("frames", (hidden, dots(index=1), hidden)), ("other", (hidden, hidden))):
        for k, image in enumerate(shown):
            save(tmp_path / folder / f"{k}.png", image)
        summary = json.loads(typed("track", rest, folder, *DARK, "--json").stdout)
        assert summary["frames"] == (4 if folder == "frames" else 2)
        told = "not in the first frames of" in str(summary["source_doubt"])
        assert told == (folder == "other")


@pytest.mark.parametrize("sigma", [0.0, 2.0])
def test_noise_is_estimated(sigma: float) -> None:
    """From four frames and from one, with 800 markers' edges in it; never less than .3."""
    frames, still = [], PAINTER.render(REST)
    for k in range(4):
        frames.append(Frame(image=still.copy(), time=0.0))
        add_noise(frames[k].image, sigma, 9, k)
    sigma = max(sigma, 0.3)
    assert noise_level(frames, False)[0] == pytest.approx(sigma, rel=0.03)
    assert noise_level(frames[:1], False)[0] == pytest.approx(sigma, rel=0.1, abs=0.15)


@pytest.fixture(scope="module")
def odd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files that are not what they should be, and some that are."""
    folder = tmp_path_factory.mktemp("odd")
    image = dots()
    for name in ("dots.png", "rest.png", "frames/0.png", "sizes/0.png"):
        save(folder / name, image)
    for name in ("small.png", "sizes/1.png"):
        save(folder / name, image[:, :180])
    for name in ("run/summary.json", "run/trace.parquet", "set/manifest.json", "set/sequence-0/0"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    save(folder / "grey.png", np.full((150, 200, 3), 200, np.uint8))
    (folder / "text.mp4").write_text("no film\n" * 99, encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("detect text.mp4", "text.mp4 is no picture; detect takes one .* `chromagrip track` reads"),
        ("detect grey.png", "picture grey.png: no regular marker pattern found in the picture"),
        ("detect dots.png --crop 1,2,3", "--crop 1,2,3: expected left,top,width,height"),
        ("detect dots.png --crop 9,9,192,90", "does not lie in the picture of 200×150 pixels"),
        ("detect dots.png --mask small.png", "mask small.png is 180×150 pixels, the picture 200"),
        ("detect dots.png --mask grey.png", "grey.png is a picture, no mask: .* is neither bl"),
        ("track frames rest.png DARK", "are swapped: give the rest picture first"),
        ("track sizes frames DARK", "rest frames have different sizes: 180×150, 200×150 pixels"),
        ("track first:3 frames DARK", "rest first:3 needs 3 frames; frames has 1"),
        ("track none.png frames DARK", "rest none.png: there is no such file or folder; give a "),
        ("track dots.png run DARK", "folder run is a run, whose frames are in run/tactile.mp4"),
        ("track dots.png set DARK", "folder set is a dataset: give one of .* such as set/seq"),
        ("track small.png frames DARK", r"frame 0 of frames \(0.png\) is 200×150 .* 180×150"),
        ("track auto frames DARK", "chromagrip: rest auto needs two layers .* shows dark alone"),
        ("track camera:9 frames DARK", "rest camera:9 is a camera; give a picture"),
        ("track first frames DARK --tracker mine:Endless", "has no reset"),
        ("track first frames DARK --tracker mine:Nothing", "gave a NoneType; expected"),
    ],
)
def test_errors_are_one_sentence_and_exit_code_2(
    words: str, told: str, odd: Path, typed: Typed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(odd)
    monkeypatch.setitem(sys.modules, "mine", sys.modules[__name__])
    asked = words.replace("DARK", "--palette dark-dots").split()
    if "track" in asked and "--tracker" not in asked:
        asked += ["--tracker", "detect"]
    done = typed(*asked)
    assert done.returncode == 2
    assert re.search(told, done.stderr)
    assert (len(done.stderr.strip().splitlines()), done.stdout) == (1, "")
    assert not (odd / "runs").exists()


def test_no_line_reaches_the_next_marker_and_the_factor_never_grows() -> None:
    places = DOTS[None].astype(float)
    rest = Tracks.of_positions(0.0, places)
    away = np.linalg.norm(places[0][:, None] - places[0], axis=2)
    spacing = np.median(np.where(away > 0.0, away, np.inf).min(axis=1))
    motion, factors = Magnification(rest), []
    for time, shift in enumerate((0.1, 0.17, 0.35, 0.1, 2.0)):
        shifted = places + np.array([shift * spacing, 0.0])
        factors.append(motion.after(Tracks.of_positions(float(time), shifted)))
    assert factors == [MAGNIFY, 4, 2, 2, 1]  # at most 0.8 of the spacing; at 1 it ends at the mark
    # A doubtful marker does not decide, and one without a neighbour has no limit.
    far = Tracks.of_positions(1.0, places + np.array([spacing, 0.0]))
    doubtful = replace(far, ambiguous=np.ones_like(far.ambiguous))
    assert Magnification(rest).after(doubtful) == MAGNIFY
    alone = Tracks.of_positions(0.0, places[:, :1])
    assert Magnification(alone).after(Tracks.of_positions(1.0, places[:, :1] + 50.0)) == MAGNIFY
