import functools
import json
import re
import signal
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import av
import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial import KDTree

from chromagrip.cli.app import main
from chromagrip.errors import UserError
from chromagrip.model import Fingertip
from chromagrip.output.parquet import TRACKS
from chromagrip.pictures.noise_level import noise_level
from chromagrip.pictures.overlay import MAGNIFY, Magnification
from chromagrip.pictures.track import track_source
from chromagrip.render import Frame, Membrane, MembraneMap, add_noise, load_sensor, open_renderer
from chromagrip.render.outlines import areas, centroids, outlines
from chromagrip.sensing import reader
from chromagrip.sources import open_source
from chromagrip.tracking import Palette, Tracks, load_tracker

Run = Callable[..., int]
SENSOR = load_sensor("thesis")
PAINTER = open_renderer("painter", SENSOR)
REST = MembraneMap(SENSOR, 251)(np.zeros((Fingertip().nodes, 2)))
NOISE = 2.0
#: Dark dots, not in a row so that no two are alike [px].
DOTS = np.stack(np.meshgrid(np.arange(30, 220, 36), np.arange(30, 160, 36)), -1).reshape(-1, 2)
DOTS = DOTS + np.random.default_rng(5).uniform(-3.0, 3.0, DOTS.shape)
DOC = Path(__file__).parents[2] / "docs" / "extend.md"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Iterator[Run]:
    """Runs a command and gives its exit code; its output is left to be captured."""
    before = signal.getsignal(signal.SIGINT)

    def command(*words: object) -> int:
        monkeypatch.setattr(sys, "argv", ["chromagrip", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        return int(ended.value.code or 0)

    yield command
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def nearest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The tracker that the documentation shows."""
    text = DOC.read_text(encoding="utf-8")
    code = re.search(r"```python\n(# my_tracker\.py\n.*?)```", text, re.DOTALL)
    assert code is not None
    (tmp_path / "my_module.py").write_text(code[1], encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "my_module", raising=False)
    return "my_module:Nearest"


@functools.cache
def dots(shift: float = 0.0, index: int = 0, size: tuple[int, int] = (240, 180)) -> np.ndarray:
    """Dark dots of radius 6, moved rightwards, on a shaded ground, with noise 1; RGB."""
    y, x = np.mgrid[: size[1], : size[0]]
    far = KDTree(DOTS + np.array([shift, 0.0])).query(np.stack([x, y], axis=-1))[0]
    covered = 1.0 / (1.0 + np.exp((far - 6.0) / 0.5))
    light = (0.75 - 0.2 * x / 240) * (1.0 - 0.85 * covered)
    level = 255.0 * (1.055 * light ** (1 / 2.4) - 0.055)
    grey = np.random.default_rng(index).normal(level, 1.0)
    return np.repeat(np.rint(grey).astype(np.uint8)[..., None], 3, axis=2)


def write(path: Path, image: np.ndarray) -> Path:
    path.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1])
    return path


def write_video(path: Path, images: list[np.ndarray], crf: int = 4) -> Path:
    """H.264 at 50 Hz, its index in front so that a cut file still opens."""
    options = {"movflags": "faststart"} if path.suffix == ".mp4" else {}
    with av.open(str(path), "w", options=options) as container:
        stream = container.add_stream("libx264", rate=50)
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuv444p"
        stream.options = {"crf": str(crf), "preset": "ultrafast", "g": "1"}
        for image in images:
            for packet in stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return path


def painted(shift: float, index: int) -> np.ndarray:
    """The fingertip with its outer layer moved along x [m]."""
    image = PAINTER.render(moved(shift))
    add_noise(image, NOISE, 3, index)
    return image


def moved(shift: float) -> Membrane:
    centres = REST.centres.copy()
    centres[0, :, 0] += shift
    return Membrane(centres=centres, axes=REST.axes)


def read(out: Path) -> tuple[dict[str, Any], dict[str, np.ndarray], Any]:
    """Summary, columns and schema of a folder."""
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    table = pq.read_table(out / "tracks.parquet")
    columns = {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}
    return summary, columns, table.schema


def overlay(out: Path) -> list[av.VideoFrame]:
    with av.open(str(out / "overlay.mp4")) as video:
        return list(video.decode(video=0))


@pytest.fixture(scope="module")
def dome(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four rest frames and eight of a shear, the sixth with a finger on the lens."""
    folder = tmp_path_factory.mktemp("dome")
    for k in range(4):
        write(folder / "rest" / f"{k}.png", painted(0.0, 100 + k))
    for k in range(8):
        image = painted(2e-5 * k, k)
        if k == 5:
            image[200:260, 330:420] = 128
        write(folder / "frames" / f"frame-{k}.png", image)
    return folder


def test_detect_lists_both_layers(
    dome: Path, tmp_path: Path, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = dome / "frames" / "frame-4.png"
    out = tmp_path / "seen.png"
    assert run("detect", picture, "--json", "--out", out) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["width_px"], report["height_px"]) == (640, 480)
    truth = centroids(outlines(moved(8e-5), SENSOR.view), square=False)
    numbers = []
    for k, name in enumerate(("magenta", "yellow")):
        rows = [row for row in report["markers"] if row["layer"] == name]
        assert len(rows) == 400
        at = np.array([[row["x_px"], row["y_px"]] for row in rows])
        distance, number = KDTree(truth[k]).query(at)
        assert sorted(number) == list(range(400))
        assert np.sqrt((distance**2).mean()) < 0.25
        area = np.array([row["area_px2"] for row in rows])
        true_area = areas(outlines(moved(8e-5), SENSOR.view), square=False)[k, number]
        assert np.median(area / true_area) == pytest.approx(1.0, abs=0.05)
        numbers.append({row["pair"]: n for row, n in zip(rows, number, strict=True)})
    # A pair is one marker of the design, moved apart by up to 1.5 px.
    assert None not in numbers[0]
    assert numbers[0] == numbers[1]
    drawn = cv2.imread(str(out))
    assert drawn is not None
    assert drawn.shape[1] == 1280


def test_the_palette_that_was_found_finds_the_same_again(
    tmp_path: Path, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    picture, saved = write(tmp_path / "dots.png", dots()), tmp_path / "mine.toml"
    assert run("detect", picture, "--save-palette", saved, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert run("detect", picture, "--palette", saved, "--json") == 0
    again = json.loads(capsys.readouterr().out)
    assert run("detect", picture, "--palette", "dark-dots") == 0
    layer, count = capsys.readouterr().out.splitlines()[-2].split()[:2]
    assert (layer, int(count)) == ("dark", len(DOTS))
    assert (found["palette"], again["palette"]) == ("auto", str(saved))
    assert found["dyes"]["dark"] == pytest.approx(again["dyes"]["dark"], rel=1e-3)
    assert found["dyes"]["dark"] == pytest.approx([0.15] * 3, abs=0.04)
    places = [[(m["x_px"], m["y_px"]) for m in one["markers"]] for one in (found, again)]
    assert np.max(KDTree(places[0]).query(DOTS)[0]) < 0.3
    np.testing.assert_allclose(places[0], places[1], atol=0.02)


def test_tracks_are_where_the_markers_are(
    dome: Path, tmp_path: Path, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "tracks"
    words = ("track", dome / "rest", dome / "frames", "--fps", 50, "--out", out, "--json")
    assert run(*words) == 0
    summary, columns, schema = read(out)
    assert json.loads(capsys.readouterr().out) == summary
    assert summary["format"] == "chromagrip track 1"
    assert (summary["frames"], summary["fps"], summary["complete"]) == (8, 50.0, True)
    assert summary["noise_levels"] == pytest.approx(NOISE, rel=0.05)
    assert list(columns) == list(TRACKS) == schema.names
    assert {k.decode() for k in schema.metadata} >= set(TRACKS)
    assert len(columns["frame"]) == 8 * 2 * 400
    np.testing.assert_allclose(columns["time_s"], columns["frame"] / 50.0)
    truth = [centroids(outlines(moved(2e-5 * k), SENSOR.view), square=False) for k in range(8)]
    start = columns["frame"] == 0
    for k, name in enumerate(("magenta", "yellow")):
        of_layer = columns["layer"] == name
        at = np.stack([columns["x_px"], columns["y_px"]], axis=-1)
        # Which marker of the design a number is, by its place in the first frame.
        number = KDTree(truth[0][k]).query(at[of_layer & start])[1]
        assert sorted(number) == list(range(400))
        design = number[columns["marker"][of_layer]]
        expected = np.stack([t[k] for t in truth])[columns["frame"][of_layer], design]
        error = at[of_layer] - expected
        seen = columns["visible"][of_layer]
        assert (np.isnan(error).any(axis=1) == ~seen).all()
        assert np.sqrt((error[seen] ** 2).mean()) < 0.03
        x, y = expected.T
        covered = (x > 336) & (x < 414) & (y > 206) & (y < 254)
        under = covered & (columns["frame"][of_layer] == 5)
        assert under.sum() > 3
        assert not seen[under].any()
        assert seen[~under].mean() > 0.98
        np.testing.assert_allclose(columns["last_seen_s"][of_layer][under], 4 / 50.0)
        share = summary["layers"][name]
        assert share == {"markers": 400, "visible_share": pytest.approx(seen.mean())}
    pictures = overlay(out)
    assert len(pictures) == 8
    assert pictures[0].width == 1280
    # Red crosses over the finger, and only there.
    red = [
        (np.abs(p.to_ndarray(format="rgb24").astype(int) - (215, 25, 30)).max(axis=2) < 30).sum()
        for p in pictures
    ]
    assert red[5] - red[4] > 1000


def test_ones_own_tracker_and_dots_in_natural_order(nearest: str, tmp_path: Path, run: Run) -> None:
    """frame-2 comes before frame-10; the shift is proportional to the number."""
    for k in range(11):
        write(tmp_path / "frames" / f"frame-{k}.png", dots(0.7 * k, k))
    (tmp_path / "frames" / "notes.txt").write_text("not a picture", encoding="utf-8")
    out = tmp_path / "out"
    words = ("--palette", "dark-dots", "--tracker", nearest, "--out", out)
    assert run("track", "first", tmp_path / "frames", *words) == 0
    summary, columns, _ = read(out)
    assert summary["fps"] == 30.0
    assert summary["noise_levels"] == pytest.approx(1.0, abs=0.3)
    x = columns["x_px"].reshape(11, len(DOTS))
    shift = np.broadcast_to(0.7 * np.arange(11)[:, None], x.shape)
    np.testing.assert_allclose(x - x[0], shift, atol=0.15)
    rest = np.stack([columns["rest_x_px"], columns["rest_y_px"]], axis=-1).reshape(11, -1, 2)
    assert (rest == rest[0]).all()
    np.testing.assert_allclose(x - rest[..., 0], shift, atol=0.15)
    np.testing.assert_allclose(rest[0][np.lexsort(rest[0].T)], DOTS[np.lexsort(DOTS.T)], atol=0.15)
    assert np.isnan(columns["var_xx_px2"]).all()  # not measured


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("film") / "dots.mp4"
    return write_video(path, [dots(0.5 * k, k) for k in range(6)])


def test_a_video_has_its_own_times_or_those_given(
    film: Path, nearest: str, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows are written as they come: memory does not wait for the end."""
    monkeypatch.setattr("chromagrip.output.parquet._TRACK_GROUP", 2 * len(DOTS))
    words = ("track", "first:1", film, "--palette", "dark-dots", "--tracker", nearest)
    for name, options, rate in (("own", (), 50.0), ("given", ("--fps", 200), 200.0)):
        out = tmp_path / name
        assert run(*words, *options, "--out", out) == 0
        summary, columns, _ = read(out)
        assert (summary["frames"], summary["fps"]) == (6, rate)
        np.testing.assert_allclose(columns["time_s"], columns["frame"] / rate, atol=1e-6)
        x = columns["x_px"].reshape(6, len(DOTS))
        np.testing.assert_allclose((x - x[0]).mean(axis=1), 0.5 * np.arange(6), atol=0.02)
        assert pq.ParquetFile(out / "tracks.parquet").num_row_groups == 3
    out = tmp_path / "short"
    assert run(*words, "--frames", 3, "--out", out) == 0
    summary, columns, _ = read(out)
    assert (summary["complete"], summary["ended"]) == (True, "after 3 frames, as asked")
    assert columns["frame"].max() == 2


def _cut_film(film: Path, folder: Path) -> Path:
    path = folder / "cut.mp4"
    data = film.read_bytes()
    path.write_bytes(data[: int(0.7 * len(data))])
    return path


def _cut_matroska(film: Path, folder: Path) -> Path:
    """Which has no index that tells how many there are."""
    path = write_video(folder / "cut.mkv", [dots(0.5 * k, k) for k in range(10)])
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


def _cut_picture(film: Path, folder: Path) -> Path:
    for k in range(4):
        path = write(folder / "frames" / f"{k}.png", dots(0.5 * k, k))
        if k == 3:
            path.write_bytes(path.read_bytes()[:2000])
    return folder / "frames"


@pytest.mark.parametrize(
    ("broken", "frames", "told"),
    [
        (_cut_film, (2, 4), r"video .*cut.mp4 breaks off after \d of 6 frames"),
        (_cut_matroska, (3, 6), r"cut.mkv breaks off after [3-6] frames.*should last 0.2 s"),
        (_cut_picture, (3, 3), r"picture .*3.png cannot be read: it is cut off, or not a png file"),
    ],
)
def test_what_breaks_off_keeps_the_tracks_up_to_there(
    broken: Any,
    frames: tuple[int, int],
    told: str,
    film: Path,
    nearest: str,
    tmp_path: Path,
    run: Run,
    capfd: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out"
    words = ("--palette", "dark-dots", "--tracker", nearest, "--out", out)
    assert run("track", "first", broken(film, tmp_path), *words) == 2
    sentence = capfd.readouterr().err.strip()
    assert re.search(told, sentence)
    assert len(sentence.splitlines()) == 1
    summary, columns, _ = read(out)
    assert frames[0] <= summary["frames"] <= frames[1]
    assert not summary["complete"]
    assert summary["ended"] in sentence
    x = columns["x_px"].reshape(summary["frames"], len(DOTS))
    shift = 0.5 * np.arange(summary["frames"])
    np.testing.assert_allclose((x - x[0]).mean(axis=1), shift, atol=0.02)
    assert len(overlay(out)) == summary["frames"]


class Endless:
    """Gives dots without end, as a camera does."""

    count = 0

    def read(self) -> tuple[np.ndarray, float]:
        self.count += 1
        return dots(index=self.count), 0.02 * self.count


@pytest.mark.parametrize(
    ("source", "limit", "code"),
    [("film", (), 130), ("mine:Endless", (), 0), ("mine:Endless", ("--frames", 9), 130)],
)
def test_an_interruption_keeps_what_there_is_and_is_the_end_of_a_camera(
    source: str,
    limit: tuple[object, ...],
    code: int,
    film: Path,
    nearest: str,
    tmp_path: Path,
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "mine", sys.modules[__name__])
    interrupted = Mock(side_effect=[None, None, None, KeyboardInterrupt])  # as Ctrl-C does
    monkeypatch.setattr(reader, "check_tracks", interrupted)
    words = ("--palette", "dark-dots", "--tracker", nearest, "--out", tmp_path / "out", *limit)
    source = str(film) if source == "film" else source
    assert run("track", "first:2", source, *words) == code
    summary, columns, _ = read(tmp_path / "out")
    assert (summary["frames"], summary["complete"]) == (3, code == 0)
    assert summary["ended"] == "interrupted" or code == 0
    assert columns["frame"].max() == 2
    assert (np.diff(columns["time_s"][:: len(DOTS)]) > 0.0).all()


class Failing:
    """The tracker of the documentation, which raises an error at the third frame."""

    def __init__(self, kind: Any, error: BaseException, palette: Palette, noise: float) -> None:
        self.tracker, self.error, self.count = kind(palette, noise), error, 0

    def reset(self, rest: list[Frame]) -> Tracks:
        tracks: Tracks = self.tracker.reset(rest)
        return tracks

    def update(self, frame: Frame) -> Tracks:
        self.count += 1
        if self.count == 3:
            raise self.error
        tracks: Tracks = self.tracker.update(frame)
        return tracks


@pytest.mark.parametrize("error", [SystemExit(0), ValueError("a bug")])
def test_a_tracker_that_fails_keeps_what_it_gave(
    error: BaseException, film: Path, nearest: str, tmp_path: Path
) -> None:
    """An exit is not the end of the program, which would look like success; a bug is shown."""
    tracker = functools.partial(Failing, load_tracker(nearest), error)
    out, told = tmp_path / "out", "ValueError: a bug"
    words: dict[str, Any] = {"palette": "dark-dots", "tracker": tracker, "out": out}
    if isinstance(error, ValueError):
        with pytest.raises(ValueError, match="a bug") as raised:
            track_source("first", str(film), **words)
        assert raised.value is error
    else:
        told = str(track_source("first", str(film), **words).broken)
        place = r"\(test_track_commands.py, line \d+\)"
        assert re.match(rf"tracker '.*:Failing' failed: SystemExit: 0 {place}; .* 2 frames", told)
    summary, columns, _ = read(out)
    assert (summary["frames"], summary["complete"], summary["ended"]) == (2, False, told)
    assert columns["frame"].max() == 1


@pytest.mark.data
def test_auto_finds_the_frame_at_rest(nearest: str, tmp_path: Path, run: Run) -> None:
    for k, shift in enumerate((6e-5, 0.0, 3e-5)):
        write(tmp_path / "frames" / f"{k}.png", painted(shift, k))
    words = ("--tracker", nearest, "--out", tmp_path / "out")
    assert run("track", "auto", tmp_path / "frames", *words) == 0
    assert read(tmp_path / "out")[0]["rest"] == "frame 1 of the source, found"


def test_a_rest_picture_beside_the_frames_is_not_one_of_them(
    nearest: str, tmp_path: Path, run: Run
) -> None:
    """One with a frame's name is both."""
    for name in ("0.png", "1.png", "rest.png"):
        write(tmp_path / "frames" / name, dots())
    words = ("--palette", "dark-dots", "--tracker", nearest)
    frames = tmp_path / "frames"
    assert run("track", frames, frames / "rest.png", *words) == 2  # swapped
    for rest, count in (("rest.png", 2), ("0.png", 2)):
        out = tmp_path / rest
        picture = tmp_path / "frames" / rest
        assert run("track", picture, picture.parent, *words, "--out", out) == 0
        summary = read(out)[0]
        assert summary["frames"] == count
        assert summary["rest"].endswith("not counted as a frame of the source") == (
            rest == "rest.png"
        )


def test_another_sensor_s_pictures_are_doubted(
    nearest: str, tmp_path: Path, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not a finger that covers most of the sensor later."""
    covered = dots().copy()
    covered[:, 80:] = 200
    for k, image in enumerate((covered, dots(index=1), covered, covered, covered)):
        write(tmp_path / "frames" / f"{k}.png", image)
    for k in range(2):
        write(tmp_path / "other" / f"{k}.png", covered)
    write(tmp_path / "dots.png", dots())
    words = ("--palette", "dark-dots", "--tracker", nearest)
    for folder, doubted in (("frames", False), ("other", True)):
        source, out = tmp_path / folder, tmp_path / f"out-{folder}"
        call = ("track", tmp_path / "dots.png", source, *words, "--out", out)
        assert run(*call) == 0
        told = "not in the first frames of" in " ".join(capsys.readouterr().out.split())
        doubt = read(out)[0]["source_doubt"]
        assert (told, doubt is not None) == (doubted, doubted)


def test_folders_keep_what_follows_a_dot(
    film: Path, nearest: str, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "run.1" / "0.png", dots())
    write(tmp_path / "a.b.png", dots())
    for source in ("run.1", "a.b.png", "./run.1/."):
        words = ("--palette", "dark-dots", "--tracker", nearest)
        assert run("track", "first", source, *words) == 0
    names = {path.name for path in (tmp_path / "runs").iterdir()}
    assert names == {"track-run.1-001", "track-a.b-001", "track-run.1-002"}


@pytest.mark.parametrize("sigma", [0.0, 0.5, 2.0, 6.0])
def test_noise_is_estimated(sigma: float) -> None:
    """From four frames and from one, with 800 markers' edges in it; never less than .3."""
    frames = []
    for k in range(4):
        image = PAINTER.render(REST)
        add_noise(image, sigma, 9, k)
        frames.append(Frame(image=image, time=0.0))
    sigma = max(sigma, 0.3)
    assert noise_level(frames, False)[0] == pytest.approx(sigma, rel=0.03)
    assert noise_level(frames[:1], False)[0] == pytest.approx(sigma, rel=0.1, abs=0.15)


@pytest.mark.data
def test_compressed_pictures_are_tracked_with_the_errors_of_compression(
    tmp_path: Path, run: Run
) -> None:
    """Their still parts have no noise at all, their markers have errors of several levels."""
    video = write_video(tmp_path / "dome.mp4", [painted(2e-5 * k, k) for k in range(5)], crf=23)
    words = ("--out", tmp_path / "out", "--frames", 5)
    assert run("track", "first", video, *words) == 0
    summary, columns, _ = read(tmp_path / "out")
    for layer in summary["layers"].values():
        assert layer["markers"] == 400
        assert layer["visible_share"] > 0.98
    x = columns["x_px"].reshape(5, 2, 400)[:, 0]
    truth = [centroids(outlines(moved(d), SENSOR.view), square=False)[0, :, 0] for d in (0, 8e-5)]
    assert np.nanmedian(x[4] - x[0]) == pytest.approx(np.median(truth[1] - truth[0]), abs=0.1)


BAD_TRACKERS = """
class NoUpdate:
    def reset(self, rest): ...

class Nothing:
    def __init__(self, palette, noise): ...
    def reset(self, rest): ...
    def update(self, frame): ...
"""


@pytest.fixture(scope="module")
def odd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files that are not what they should be, and some that are."""
    folder = tmp_path_factory.mktemp("odd")
    image = dots()
    write(folder / "dots.png", image)
    (folder / "none").mkdir()
    write(folder / "frames" / "0.png", image)
    write(folder / "sizes" / "0.png", image)
    write(folder / "sizes" / "1.png", image[:, :200])
    for name in ("run/summary.json", "run/trace.parquet", "set/manifest.json", "set/sequence-0/0"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    for name in ("empty.png", "empty.mp4"):
        (folder / name).touch()
    for name in ("text.mp4", "text.txt"):
        (folder / name).write_text("no film\n" * 99, encoding="utf-8")
    clear = np.dstack([image, np.full(image.shape[:2], 128, np.uint8)])
    cv2.imwrite(str(folder / "clear.png"), clear)
    clear[..., 3] = 255
    cv2.imwrite(str(folder / "opaque.png"), clear)
    write(folder / "grey.png", np.full((180, 240, 3), 200, np.uint8))
    write(folder / "small.png", image[:, :200])
    write(folder / "dome.png", painted(0.0, 1))
    loaded = moved(0.0)
    near = np.linalg.norm(REST.centres[0, :, :2], axis=-1) < 2.5e-3
    loaded.centres[0, near, 0] += 1.5e-4
    write(folder / "loaded.png", PAINTER.render(loaded))
    (folder / "bad_trackers.py").write_text(BAD_TRACKERS, encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("detect none.png", "picture none.png cannot be read: No such file"),
        ("detect text.mp4", "text.mp4 is no picture; detect takes one .* `chromagrip track` reads"),
        ("detect empty.png", "picture empty.png is empty"),
        ("detect clear.png", "picture clear.png has transparent pixels"),
        ("detect dots.png --palette chromatouch", "image is grey .* need a colour image"),
        ("detect grey.png", "picture grey.png: no regular marker pattern found in the picture"),
        ("detect dots.png --crop 1,2,3", "--crop 1,2,3: expected left,top,width,height"),
        ("detect dots.png --crop 9,9,300,90", "does not lie in the picture of 240×180 pixels"),
        ("detect dots.png --crop 0,0,240,20", "no regular marker pattern found in the picture"),
        ("detect dots.png --mask small.png", "mask small.png is 200×180 pixels, the picture 240"),
        ("detect dots.png --mask grey.png", "grey.png is a picture, no mask: .* is neither bl"),
        ("detect dots.png --save-palette a.txt", "must end in .toml"),
        ("detect dots.png --palette nosuch", "no palette 'nosuch'; there is .*dark-dots"),
        ("detect dots.png --palette dark-dots --out dots.png", "exists; choose another or give"),
        ("detect dots.png --palette dark-dots --out a.jpg", "must end in .png"),
        ("track first none DARK", "folder none has no pictures"),
        ("track sizes frames DARK", "rest frames have different sizes: 200×180, 240×180 pixels"),
        ("track first empty.mp4 DARK", "video empty.mp4 is empty"),
        ("track first text.mp4 DARK", "text.mp4 cannot be read as a video: invalid data"),
        ("track first text.txt DARK", "text.txt has no video in it"),
        ("track first:3 frames DARK", "rest first:3 needs 3 frames; frames has 1"),
        ("track first:0 frames DARK", "rest first:0 is no frame"),
        ("track none.png frames DARK", "rest none.png: there is no such file or folder; give a "),
        ("track dots.png run DARK", "folder run is a run, whose frames are in run/tactile.mp4"),
        ("track dots.png set DARK", "folder set is a dataset: give one of .* such as set/seq"),
        ("track first:x frames DARK", "rest first:x: there is no .* first, first:N or auto"),
        ("track small.png frames DARK", r"frame 0 of frames \(0.png\) is 240×180 .* 200×180"),
        ("track grey.png frames DARK", "rest grey.png: no regular marker pattern found in the pic"),
        ("track auto grey.png DARK", "can use no frame of grey.png; .* no regular marker pattern"),
        ("track loaded.png dome.png --palette thesis", "rest frame looks loaded: around"),
        ("track auto frames DARK", "chromagrip: rest auto needs two layers .* shows dark alone"),
        ("track auto camera:9", "rest auto looks at every frame twice"),
        ("track camera:9 frames DARK", "rest camera:9 is a camera; give a picture"),
        ("track first camera:99 DARK", "camera 99 cannot be opened"),
        ("track first frames DARK --noise nan", "--noise nan: expected 0 or more"),
        ("track first frames DARK --tracker blob", "no tracker 'blob'; there is fit, .*centroid"),
        ("track first frames DARK --tracker bad_trackers:NoUpdate", "has no update"),
        ("track first frames DARK --tracker bad_trackers:Nothing", "gave a NoneType; expected"),
        ("track first frames DARK --out none/../frames", "frames is not empty"),
    ],
)
def test_errors_are_one_sentence_and_exit_code_2(
    words: str,
    told: str,
    odd: Path,
    nearest: str,
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(odd)
    monkeypatch.syspath_prepend(odd)
    asked = words.split()
    if "DARK" in asked:
        asked.remove("DARK")
        asked += ["--palette", "dark-dots"]
    if "track" in asked and "--tracker" not in asked:
        asked += ["--tracker", nearest]
    assert run(*asked) == 2
    printed, told_by = capfd.readouterr()
    assert re.search(told, told_by)
    assert len(told_by.strip().splitlines()) == 1
    assert printed == ""
    assert not (odd / "runs").exists()


def test_an_opaque_picture_with_alpha_will_do(odd: Path) -> None:
    (frame,) = open_source(str(odd / "opaque.png")).frames()
    assert (frame.image == dots()).all()


def test_a_disk_that_is_full_leaves_no_tracks(
    film: Path, nearest: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The summary, which is small, still says how it ended."""

    def full(self: Any, picture: object) -> None:
        raise UserError(f"{self._path} cannot be written: No space left on device")

    monkeypatch.setattr("chromagrip.pictures.overlay.OverlayVideo.append", full)
    out = tmp_path / "out"
    with pytest.raises(UserError, match=r"overlay.mp4 cannot be written: No space left on device$"):
        track_source("first", str(film), palette="dark-dots", tracker=nearest, out=out)
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert not summary["complete"]
    assert summary["ended"].endswith("No space left on device")
    assert not (out / "overlay.mp4").exists()


def test_no_line_reaches_the_next_marker_and_the_factor_never_grows() -> None:
    places = DOTS[None].astype(float)
    rest = Tracks.of_positions(0.0, places)
    away = np.linalg.norm(places[0][:, None] - places[0], axis=2)
    spacing = np.median(np.where(away > 0.0, away, np.inf).min(axis=1))
    motion, factors = Magnification(rest), []
    for time, shift in enumerate((0.1, 0.17, 0.35, 0.1, 2.0)):
        moved = places + np.array([shift * spacing, 0.0])
        factors.append(motion.after(Tracks.of_positions(float(time), moved)))
        if factors[-1] > 1:
            assert factors[-1] * shift <= 0.8
    assert factors == [MAGNIFY, 4, 2, 2, 1]  # at 1 a line ends at the marker
    # A doubtful marker does not decide, and one without a neighbour has no limit.
    far = Tracks.of_positions(1.0, places + np.array([spacing, 0.0]))
    doubtful = replace(far, ambiguous=np.ones_like(far.ambiguous))
    assert Magnification(rest).after(doubtful) == MAGNIFY
    alone = Tracks.of_positions(0.0, places[:, :1])
    assert Magnification(alone).after(Tracks.of_positions(1.0, places[:, :1] + 50.0)) == MAGNIFY
