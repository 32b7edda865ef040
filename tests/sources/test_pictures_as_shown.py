"""Pictures and videos are read as viewers show them: turned, page by page, in levels of 8 bits."""

import io
import struct
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import av
import cv2
import numpy as np
import pytest
from PIL import Image, ImageOps, TiffImagePlugin

from chromagrip.errors import UserError
from chromagrip.pictures.find_sensor import Within
from chromagrip.sources import open_source
from chromagrip.sources.picture_files import read_picture

Typed = Callable[..., CompletedProcess[str]]
RNG = np.random.default_rng(8)
#: Numbers of 40 pictures, four of which are missing.
SOME = sorted({*range(40)} - {9, 17, 18, 25})
#: Smooth colours without any symmetry, so that JPEG keeps them.
SHOWN = cv2.resize(RNG.integers(0, 256, (3, 4, 3)).astype(np.uint8), (32, 24))
#: Signs of a, b, c and d of a video's matrix by the orientation of EXIF, and the turn that FFmpeg
#: reads in those that do not mirror [°, to the left].
MATRICES = {
    1: ((1, 0, 0, 1), 0), 2: ((-1, 0, 0, 1), None), 3: ((-1, 0, 0, -1), 180),
    4: ((1, 0, 0, -1), None), 5: ((0, 1, 1, 0), None), 6: ((0, 1, -1, 0), -90),
    7: ((0, -1, -1, 0), None), 8: ((0, -1, 1, 0), 90),
}  # fmt: skip


def stored(orientation: int, kind: str) -> tuple[bytes, np.ndarray]:
    """File of a picture with a note how it is turned, and the same as Pillow shows it."""
    image, file = Image.fromarray(SHOWN), io.BytesIO()
    if kind == "TIFF":
        note = TiffImagePlugin.ImageFileDirectory_v2()
        note[0x0112] = orientation
        image.save(file, kind, tiffinfo=note)
    else:
        exif = Image.Exif()
        exif[0x0112] = orientation
        image.save(file, kind, exif=exif, **({"lossless": True} if kind == "WEBP" else {}))
    return file.getvalue(), np.asarray(ImageOps.exif_transpose(Image.open(file)).convert("RGB"))


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "TIFF", "WEBP"])
def test_pictures_are_turned_as_their_notes_say(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"0.{kind.lower()}"
    for orientation in range(1, 9):
        data, shown = stored(orientation, kind)
        path.write_bytes(data)
        assert np.array_equal(read_picture(path), shown), orientation
        assert np.array_equal(next(open_source(str(tmp_path)).frames()).image, shown)
    assert shown.shape == (32, 24, 3)


def test_a_mask_is_turned_too(tmp_path: Path) -> None:
    left = Image.fromarray(np.repeat(np.uint8([[255] * 8 + [0] * 24]), 24, axis=0))
    exif = Image.Exif()
    exif[0x0112] = 6  # the left end is shown above
    left.save(tmp_path / "mask.png", exif=exif)
    part = Within(mask=tmp_path / "mask.png").of(32, 24)
    assert part is not None
    assert part[:8].all()
    assert not part[8:].any()


@pytest.mark.parametrize("orientation", MATRICES)
def test_videos_are_turned_as_their_matrix_says(orientation: int, tmp_path: Path) -> None:
    path = tmp_path / "turned.mp4"
    with av.open(str(path), "w") as video:
        stream = video.add_stream("libx264rgb", rate=20, options={"qp": "0"})
        stream.width, stream.height, stream.pix_fmt = 32, 24, "rgb24"
        frame = av.VideoFrame.from_ndarray(SHOWN, format="rgb24")
        video.mux([*stream.encode(frame), *stream.encode(None)])
    data = bytearray(path.read_bytes())
    at = data.index(
        struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30), data.index(b"tkhd")
    )
    signs, turn = MATRICES[orientation]
    a, b, c, d = (sign << 16 for sign in signs)
    data[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(data)
    with av.open(str(path)) as video:
        rotation = next(video.decode(video=0)).rotation
    assert turn is None or (rotation - turn) % 360 == 0
    exif = Image.Exif()
    exif[0x0112] = orientation
    image = Image.fromarray(SHOWN)
    image.info["exif"] = exif.tobytes()
    shown = np.asarray(ImageOps.exif_transpose(image))
    assert np.array_equal(next(open_source(str(path)).frames()).image, shown)


@pytest.mark.parametrize("kind", ["tif", "png", "webp"])
def test_all_pictures_of_a_file_are_frames(kind: str, tmp_path: Path) -> None:
    images = RNG.integers(0, 256, (5, 24, 32, 3)).astype(np.uint8)
    first, *others = map(Image.fromarray, images)
    durations = {} if kind == "tif" else {"duration": [20, 30, 40, 50, 60]}
    lossless = {"lossless": True} if kind == "webp" else {}
    path = tmp_path / f"several.{kind}"
    first.save(path, save_all=True, append_images=others, **durations, **lossless)
    source = open_source(str(path))
    frames = list(source.frames())
    assert source.count == 5
    assert not source.lossy
    assert np.array_equal([frame.image for frame in frames], images)
    times = np.arange(5) / 30.0 if kind == "tif" else [0.0, 0.02, 0.05, 0.09, 0.14]
    assert [frame.time for frame in frames] == pytest.approx(times)
    assert [frame.time for frame in open_source(str(path), fps=10).frames()][4] == pytest.approx(
        0.4
    )
    with pytest.raises(UserError, match="holds 5 pictures"):
        read_picture(path)
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(UserError, match=r"breaks off after \d of|cannot be read"):
        list(open_source(str(path)).frames())


def test_previews_in_a_tiff_are_no_frames(tmp_path: Path) -> None:
    preview = TiffImagePlugin.ImageFileDirectory_v2()
    preview[254] = 1
    small = Image.new("RGB", (8, 6))
    small.encoderinfo = {"tiffinfo": preview}
    Image.fromarray(SHOWN).save(tmp_path / "0.tif", save_all=True, append_images=[small])
    assert np.array_equal(read_picture(tmp_path / "0.tif"), SHOWN)


@pytest.mark.parametrize(
    ("dtype", "suffix"), [(np.uint16, "png"), (np.uint16, "tif"), (np.float32, "tif")]
)
def test_values_of_more_than_8_bits_need_a_range(dtype: type, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"0.{suffix}"
    values = RNG.uniform(900.0, 4200.0, (24, 32, 3)).astype(dtype)
    cv2.imwrite(str(path), values[..., ::-1])
    with pytest.raises(UserError, match=r"16 values from 9\d\d to 41\d\d|float32 .*--value-range"):
        read_picture(path)
    levels = read_picture(path, value_range=(1000.0, 4000.0)).astype(float)
    true = np.clip((values.astype(float) - 1000.0) / 3000.0 * 255.0, 0.0, 255.0)
    assert abs(levels - true).max() <= 0.5 + 1e-3
    np.save(tmp_path / "0.npy", np.stack([values, values]))
    frames = list(open_source(str(tmp_path / "0.npy"), value_range=(1000.0, 4000.0)).frames())
    assert np.array_equal(frames[1].image, levels)
    with pytest.raises(UserError, match="--value-range"):
        open_source(str(tmp_path / "0.npy"))
    if dtype is np.float32:
        values[3, 4] = np.nan
        cv2.imwrite(str(path), values)
        with pytest.raises(UserError, match="not numbers"):
            read_picture(path, value_range=(0.0, 1.0))


@pytest.mark.parametrize(
    ("name", "data", "kind"),
    [
        ("a.heic", b"\0\0\0\x18ftypheic", "HEIF"),
        ("a.nef", b"MM\0*\0\0\0\x08", "camera raw"),
        ("a.png", b"\0\0\0\x0cJXL \r\n", "JPEG XL"),
    ],
)
def test_what_is_not_read_is_refused_by_name(
    name: str, data: bytes, kind: str, typed: Typed, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(data + bytes(200))
    done = typed("track", "first", name)
    assert done.returncode == 2
    assert f"is {kind}, which is not read" in done.stderr
    with pytest.raises(UserError, match=f"has no pictures but {kind}, which is not read|is {kind}"):
        next(open_source(str(tmp_path)).frames())


@pytest.mark.parametrize(
    ("names", "periods"),
    [
        (["f1", "f2", "f3", "f5", "f6", "f9"], [0, 1, 2, 4, 5, 8]),
        (["f070_l", "f080_l", "f090_l", "f100_l", "f120_l"], [0, 1, 2, 3, 5]),
        (["t1000", "t1034", "t1067", "t1101", "t1134"], [0, 1, 2, 3, 4]),  # rounded times
        ([f"{10**30 + k}" for k in (1, 2, 3, 5)], [0, 1, 2, 4]),
        ([f"{k:03d}" for k in SOME], SOME),
        (["9-58", "9-59", "10-00", "10-01", "10-03"], [0, 1, 2, 3, 4]),
    ],
)
def test_pictures_that_are_missing_by_their_numbers_leave_gaps_in_time(
    names: list[str], periods: list[int], tmp_path: Path
) -> None:
    for k, name in enumerate(names):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((4, 5, 3), k, np.uint8))
    source = open_source(str(tmp_path), fps=20.0)
    frames = list(source.frames())
    assert [frame.image[0, 0, 0] for frame in frames] == list(range(len(names)))
    assert [frame.time for frame in frames] == pytest.approx([k / 20.0 for k in periods])
    if periods is SOME:
        source = open_source(str(tmp_path))
        list(source.frames())
        assert source.delivery.counts["dropped"] == 4


@pytest.mark.parametrize(
    ("one", "other", "numbers", "others"),
    [
        ("{}-left", "{}-right", range(5), range(2, 9)),
        ("{:03d}_1", "{:03d}_2", range(5), range(5)),
        ("17000{}_a", "17000{}_b", range(1, 90, 7), range(3, 93, 7)),  # times
        ("press{}", "rest{}", range(30), range(4)),
    ],
)
def test_pictures_of_two_cameras_are_not_read_one_after_the_other(
    one: str, other: str, numbers: range, others: range, tmp_path: Path
) -> None:
    for form, counted in ((one, numbers), (other, others)):
        for k in counted:
            cv2.imwrite(str(tmp_path / f"{form.format(k)}.png"), np.full((4, 5, 3), k, np.uint8))
    with pytest.raises(UserError, match=r"has .* beside") as refused:
        open_source(str(tmp_path))
    pattern = str(refused.value).split("'")[1]  # of one of them
    assert open_source(pattern).count in (len(numbers), len(others))
    assert open_source(f"{tmp_path}/*").count == len(numbers) + len(others)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (
            ["f_0.png", "f_0.jpg", "f_1.png", "f_1.jpg"],
            "has f_0 as pictures of two kinds; give one",
        ),
        (["left/1.png"], "its folder left has: give that"),
        ([*(f"frame-{k}.png" for k in range(6)), "mask.png", "rest.png"], "has mask beside frame-"),
    ],
)
def test_a_folder_that_can_be_read_in_two_ways_is_refused(
    names: list[str], words: str, tmp_path: Path
) -> None:
    (tmp_path / "empty").mkdir()
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / name), np.full((4, 5, 3), 7, np.uint8))
    with pytest.raises(UserError, match=words):
        open_source(str(tmp_path))
    if "mask.png" in names:
        assert open_source(f"{tmp_path}/frame-*.png").count == 6
        assert open_source(str(tmp_path), without=tmp_path / "mask.png").count == 6


def test_minutes_are_not_taken_for_cameras(tmp_path: Path) -> None:
    for minute in range(3):
        for second in range(0, 60, 9):
            name = f"2026-11-28_12-{minute:02d}-{second:02d}.png"
            cv2.imwrite(str(tmp_path / name), np.full((4, 5, 3), minute, np.uint8))
    levels = [frame.image[0, 0, 0] for frame in open_source(str(tmp_path)).frames()]
    assert levels == sorted(levels)
