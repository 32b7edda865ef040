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

from chromagrip.errors import UserError
from chromagrip.model import Fingertip
from chromagrip.output.parquet import TRACKS
from chromagrip.pictures.noise_level import noise_level
from chromagrip.pictures.overlay import MAGNIFY, Magnification
from chromagrip.pictures.track import track_source
from chromagrip.render import Frame, Membrane, MembraneMap, add_noise, load_sensor, open_renderer
from chromagrip.render.outlines import areas, centroids, outlines
from chromagrip.sensing import reader
from chromagrip.tracking import Tracks, load_tracker

from .drawn_dots import covered, levels

Typed = Callable[..., CompletedProcess[str]]
SENSOR = load_sensor("thesis")
PAINTER = open_renderer("painter", SENSOR)
REST = MembraneMap(SENSOR, 251)(np.zeros((Fingertip().nodes, 2)))
NOISE = 2.0
#: Dark dots, not in a row so that no two are alike [px].
DOTS = np.stack(np.meshgrid(np.arange(30, 220, 36), np.arange(30, 160, 36)), -1).reshape(-1, 2)
DOTS = DOTS + np.random.default_rng(5).uniform(-3.0, 3.0, DOTS.shape)
DOC = Path(__file__).parents[2] / "docs" / "extend.md"


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
def dots(shift: float = 0.0, index: int = 0) -> np.ndarray:
    """Dark dots of radius 6, moved rightwards, on a shaded ground, with noise 1; RGB."""
    cover = covered((240, 180), DOTS + np.array([shift, 0.0]), np.full(len(DOTS), 6.0))
    light = (0.75 - 0.2 * np.arange(240) / 240) * (1.0 - 0.85 * cover)
    return levels(np.repeat(light[..., None], 3, axis=2), 1.0, index)


def write(path: Path, image: np.ndarray) -> Path:
    path.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1])
    return path


def write_video(path: Path, images: list[np.ndarray]) -> Path:
    """H.264 at 50 Hz, its index in front so that a cut file still opens."""
    with av.open(str(path), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=50)
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuv444p"
        stream.options = {"crf": "4", "preset": "ultrafast", "g": "1"}
        frames = [av.VideoFrame.from_ndarray(image, format="rgb24") for image in images]
        for packet in [*(p for frame in frames for p in stream.encode(frame)), *stream.encode()]:
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
    """Three rest frames and five of a shear, the fourth with a finger on the lens."""
    folder = tmp_path_factory.mktemp("dome")
    for k in range(3):
        write(folder / "rest" / f"{k}.png", painted(0.0, 100 + k))
    for k in range(5):
        image = painted(2e-5 * k, k)
        if k == 3:
            image[200:260, 330:420] = 128
        write(folder / "frames" / f"frame-{k}.png", image)
    return folder


def test_detect_lists_both_layers(dome: Path, tmp_path: Path, typed: Typed) -> None:
    picture = dome / "frames" / "frame-4.png"
    out = tmp_path / "seen.png"
    report = json.loads(typed("detect", picture, "--json", "--out", out).stdout)
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


def test_the_palette_that_was_found_finds_the_same_again(tmp_path: Path, typed: Typed) -> None:
    picture, saved = write(tmp_path / "dots.png", dots()), tmp_path / "mine.toml"
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


def test_tracks_are_where_the_markers_are(dome: Path, tmp_path: Path, typed: Typed) -> None:
    out = tmp_path / "tracks"
    words = ("track", dome / "rest", dome / "frames", "--fps", 50, "--out", out, "--json")
    told = json.loads(typed(*words).stdout)
    summary, columns, schema = read(out)
    assert told == summary
    assert summary["format"] == "chromagrip track 1"
    assert (summary["frames"], summary["fps"], summary["complete"]) == (5, 50.0, True)
    assert summary["noise_levels"] == pytest.approx(NOISE, rel=0.05)
    assert list(columns) == list(TRACKS) == schema.names
    assert {k.decode() for k in schema.metadata} >= set(TRACKS)
    assert len(columns["frame"]) == 5 * 2 * 400
    np.testing.assert_allclose(columns["time_s"], columns["frame"] / 50.0)
    truth = [centroids(outlines(moved(2e-5 * k), SENSOR.view), square=False) for k in range(5)]
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
        under = covered & (columns["frame"][of_layer] == 3)
        assert under.sum() > 3
        assert not seen[under].any()
        assert seen[~under].mean() > 0.98
        np.testing.assert_allclose(columns["last_seen_s"][of_layer][under], 2 / 50.0)
        share = summary["layers"][name]
        assert share == {"markers": 400, "visible_share": pytest.approx(seen.mean())}
    pictures = overlay(out)
    assert len(pictures) == 5
    assert pictures[0].width == 1280
    # Red crosses over the finger, and only there.
    red = [
        (np.abs(p.to_ndarray(format="rgb24").astype(int) - (215, 25, 30)).max(axis=2) < 30).sum()
        for p in pictures
    ]
    assert red[3] - red[2] > 1000


def test_ones_own_tracker_and_dots_in_natural_order(
    nearest: str, tmp_path: Path, typed: Typed
) -> None:
    """frame-2 comes before frame-10; the shift is proportional to the number."""
    for k in range(11):
        write(tmp_path / "frames" / f"frame-{k}.png", dots(0.7 * k, k))
    (tmp_path / "frames" / "notes.txt").write_text("not a picture", encoding="utf-8")
    out = tmp_path / "out"
    words = ("--palette", "dark-dots", "--tracker", nearest, "--out", out)
    assert typed("track", "first", tmp_path / "frames", *words).returncode == 0
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
    film: Path, nearest: str, tmp_path: Path, typed: Typed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows are written as they come: memory does not wait for the end."""
    monkeypatch.setattr("chromagrip.output.parquet._TRACK_GROUP", 2 * len(DOTS))
    words = ("track", "first:1", film, "--palette", "dark-dots", "--tracker", nearest)
    for name, options, rate in (("own", (), 50.0), ("given", ("--fps", 200), 200.0)):
        out = tmp_path / name
        assert typed(*words, *options, "--out", out).returncode == 0
        summary, columns, _ = read(out)
        assert (summary["frames"], summary["fps"]) == (6, rate)
        np.testing.assert_allclose(columns["time_s"], columns["frame"] / rate, atol=1e-6)
        x = columns["x_px"].reshape(6, len(DOTS))
        np.testing.assert_allclose((x - x[0]).mean(axis=1), 0.5 * np.arange(6), atol=0.02)
        assert pq.ParquetFile(out / "tracks.parquet").num_row_groups == 3
    out = tmp_path / "short"
    assert typed(*words, "--frames", 3, "--out", out).returncode == 0
    summary, columns, _ = read(out)
    assert (summary["complete"], summary["ended"]) == (True, "after 3 frames, as asked")
    assert columns["frame"].max() == 2


def _cut_film(film: Path, folder: Path) -> Path:
    path = folder / "cut.mp4"
    data = film.read_bytes()
    path.write_bytes(data[: int(0.7 * len(data))])
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
    typed: Typed,
) -> None:
    out = tmp_path / "out"
    words = ("--palette", "dark-dots", "--tracker", nearest, "--out", out)
    done = typed("track", "first", broken(film, tmp_path), *words)
    assert done.returncode == 2
    sentence = done.stderr.strip()
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
    typed: Typed,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "mine", sys.modules[__name__])
    interrupted = Mock(side_effect=[None, None, None, KeyboardInterrupt])  # as Ctrl-C does
    monkeypatch.setattr(reader, "check_tracks", interrupted)
    words = ("--palette", "dark-dots", "--tracker", nearest, "--out", tmp_path / "out", *limit)
    source = str(film) if source == "film" else source
    assert typed("track", "first:2", source, *words).returncode == code
    summary, columns, _ = read(tmp_path / "out")
    assert (summary["frames"], summary["complete"]) == (3, code == 0)
    assert summary["ended"] == "interrupted" or code == 0
    assert columns["frame"].max() == 2
    assert (np.diff(columns["time_s"][:: len(DOTS)]) > 0.0).all()


@pytest.mark.parametrize("error", [SystemExit(0), ValueError("a bug")])
def test_a_tracker_that_fails_keeps_what_it_gave(
    error: BaseException, film: Path, nearest: str, tmp_path: Path
) -> None:
    """An exit is not the end of the program, which would look like success; a bug is shown."""
    kind: Any = load_tracker(nearest)

    class Failing(kind):
        def update(self, frame: Frame) -> Tracks:
            if frame.time > 0.03:
                raise error
            tracks: Tracks = super().update(frame)
            return tracks

    out, told = tmp_path / "out", "ValueError: a bug"
    words: dict[str, Any] = {"palette": "dark-dots", "tracker": Failing, "out": out}
    if isinstance(error, ValueError):
        with pytest.raises(ValueError, match="a bug") as raised:
            track_source("first", str(film), **words)
        assert raised.value is error
    else:
        told = str(track_source("first", str(film), **words).broken)
        place = r"\(test_track_commands.py, line \d+\)"
        assert re.match(rf"tracker '.*Failing' failed: SystemExit: 0 {place}; .* 2 frames", told)
    summary, columns, _ = read(out)
    assert (summary["frames"], summary["complete"], summary["ended"]) == (2, False, told)
    assert columns["frame"].max() == 1


@pytest.mark.data
def test_auto_finds_the_frame_at_rest(nearest: str, tmp_path: Path, typed: Typed) -> None:
    for k, shift in enumerate((6e-5, 0.0, 3e-5)):
        write(tmp_path / "frames" / f"{k}.png", painted(shift, k))
    words = ("--tracker", nearest, "--out", tmp_path / "out")
    assert typed("track", "auto", tmp_path / "frames", *words).returncode == 0
    assert read(tmp_path / "out")[0]["rest"] == "frame 1 of the source, found"


def test_a_rest_picture_beside_the_frames_is_not_one_of_them(
    nearest: str, tmp_path: Path, typed: Typed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One with a frame's name is both. Folders keep what follows a dot."""
    monkeypatch.chdir(tmp_path)
    frames = Path("frames.1")
    for name in ("0.png", "1.png", "rest.png"):
        write(frames / name, dots())
    words = ("--palette", "dark-dots", "--tracker", nearest)
    assert typed("track", frames, frames / "rest.png", *words).returncode == 2  # swapped
    for k, name in enumerate(("rest.png", "0.png")):
        assert typed("track", frames / name, f"./{frames}/.", *words).returncode == 0
        summary = read(Path(f"runs/track-frames.1-{k + 1:03d}"))[0]
        assert summary["frames"] == 2
        told = summary["rest"].endswith("not counted as a frame of the source")
        assert told == (name == "rest.png")


def test_another_sensor_s_pictures_are_doubted(nearest: str, tmp_path: Path, typed: Typed) -> None:
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
        done = typed("track", tmp_path / "dots.png", source, *words, "--out", out)
        assert done.returncode == 0
        told = "not in the first frames of" in " ".join(done.stdout.split())
        doubt = read(out)[0]["source_doubt"]
        assert (told, doubt is not None) == (doubted, doubted)


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
    (folder / "text.mp4").write_text("no film\n" * 99, encoding="utf-8")
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
        ("detect dots.png --palette chromatouch", "image is grey .* need a colour image"),
        ("detect grey.png", "picture grey.png: no regular marker pattern found in the picture"),
        ("detect dots.png --crop 1,2,3", "--crop 1,2,3: expected left,top,width,height"),
        ("detect dots.png --crop 9,9,300,90", "does not lie in the picture of 240×180 pixels"),
        ("detect dots.png --mask small.png", "mask small.png is 200×180 pixels, the picture 240"),
        ("detect dots.png --mask grey.png", "grey.png is a picture, no mask: .* is neither bl"),
        ("detect dots.png --palette dark-dots --out dots.png", "exists; choose another or give"),
        ("track sizes frames DARK", "rest frames have different sizes: 200×180, 240×180 pixels"),
        ("track first:3 frames DARK", "rest first:3 needs 3 frames; frames has 1"),
        ("track none.png frames DARK", "rest none.png: there is no such file or folder; give a "),
        ("track dots.png run DARK", "folder run is a run, whose frames are in run/tactile.mp4"),
        ("track dots.png set DARK", "folder set is a dataset: give one of .* such as set/seq"),
        ("track small.png frames DARK", r"frame 0 of frames \(0.png\) is 240×180 .* 200×180"),
        ("track auto grey.png DARK", "can use no frame of grey.png; .* no regular marker pattern"),
        ("track loaded.png dome.png --palette thesis", "rest frame looks loaded: around"),
        ("track auto frames DARK", "chromagrip: rest auto needs two layers .* shows dark alone"),
        ("track camera:9 frames DARK", "rest camera:9 is a camera; give a picture"),
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
    typed: Typed,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(odd)
    monkeypatch.syspath_prepend(odd)
    asked = words.split()
    if "DARK" in asked:
        asked.remove("DARK")
        asked += ["--palette", "dark-dots"]
    if "track" in asked and "--tracker" not in asked:
        asked += ["--tracker", nearest]
    done = typed(*asked)
    assert done.returncode == 2
    assert re.search(told, done.stderr)
    assert (len(done.stderr.strip().splitlines()), done.stdout) == (1, "")
    assert not (odd / "runs").exists()


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
