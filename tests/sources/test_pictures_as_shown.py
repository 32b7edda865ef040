"""Pictures and videos are read as viewers show them: turned, page by page, in levels of 8 bits."""

import struct
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from PIL import Image, ImageOps, TiffImagePlugin

from chromagrip.errors import UserError
from chromagrip.pictures.find_sensor import Within
from chromagrip.sources import open_source
from chromagrip.sources.picture_files import read_picture

RNG = np.random.default_rng(8)
#: Numbers of 40 pictures, four of which are missing.
SOME = sorted({*range(40)} - {9, 17, 18, 25})
#: Smooth colours without any symmetry, so that JPEG keeps them.
SHOWN = cv2.resize(RNG.integers(0, 256, (3, 4, 3)).astype(np.uint8), (32, 24))
#: Signs of a, b, c and d of a video's matrix by the orientations 1 to 8 of EXIF.
MATRICES = (
    (1, 0, 0, 1), (-1, 0, 0, 1), (-1, 0, 0, -1), (1, 0, 0, -1), (0, 1, 1, 0), (0, 1, -1, 0),
    (0, -1, -1, 0), (0, -1, 1, 0),
)  # fmt: skip


def saved(path: Path, orientation: int, image: np.ndarray = SHOWN) -> np.ndarray:
    """Picture with a note how it is turned, as Pillow shows it."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    more = {"lossless": True} if path.suffix == ".webp" else {}
    Image.fromarray(image).save(path, exif=exif, **more)
    with Image.open(path) as stored:
        return np.asarray(ImageOps.exif_transpose(stored).convert("RGB"))


def written(folder: Path, *names: str) -> None:
    """Small pictures in the levels 0, 1, 2, …"""
    for k, name in enumerate(names):
        (folder / name).parent.mkdir(exist_ok=True)
        cv2.imwrite(str(folder / name), np.full((4, 5, 3), k, np.uint8))


@pytest.mark.parametrize("suffix", ["png", "jpeg", "tiff", "webp"])
def test_pictures_are_turned_as_their_notes_say(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"0.{suffix}"
    for orientation in range(1, 9):
        shown = saved(path, orientation)
        assert np.array_equal(read_picture(path), shown), orientation
        assert np.array_equal(next(open_source(str(tmp_path)).frames()).image, shown)
    assert shown.shape == (32, 24, 3)


def test_a_mask_is_turned_too(tmp_path: Path) -> None:
    left = np.repeat(np.uint8([[255] * 8 + [0] * 24]), 24, axis=0)
    saved(tmp_path / "mask.png", 6, left)  # the left end is shown above
    part = Within(mask=tmp_path / "mask.png").of(32, 24)
    assert part is not None
    assert part[:8].all()
    assert not part[8:].any()


def test_videos_are_turned_as_their_matrix_says(tmp_path: Path) -> None:
    path = tmp_path / "turned.mp4"
    with av.open(str(path), "w") as video:
        stream = video.add_stream("libx264rgb", rate=20, options={"qp": "0"})
        stream.width, stream.height, stream.pix_fmt = 32, 24, "rgb24"
        frame = av.VideoFrame.from_ndarray(SHOWN, format="rgb24")
        video.mux([*stream.encode(frame), *stream.encode(None)])
    data = bytearray(path.read_bytes())
    plain = struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
    at = data.index(plain, data.index(b"tkhd"))
    for orientation, signs in enumerate(MATRICES, 1):
        a, b, c, d = (sign << 16 for sign in signs)
        data[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
        path.write_bytes(data)
        shown = saved(tmp_path / "turned.png", orientation)
        assert np.array_equal(next(open_source(str(path)).frames()).image, shown), orientation


@pytest.mark.parametrize("kind", ["tif", "png", "webp"])
def test_all_pictures_of_a_file_are_frames(kind: str, tmp_path: Path) -> None:
    images = RNG.integers(0, 256, (5, 24, 32, 3)).astype(np.uint8)
    first, *others = map(Image.fromarray, images)
    more = {} if kind == "tif" else {"duration": [20, 30, 40, 50, 60], "lossless": True}
    path = tmp_path / f"several.{kind}"
    first.save(path, save_all=True, append_images=others, **more)
    frames = list(open_source(str(path)).frames())
    assert np.array_equal([frame.image for frame in frames], images)
    times = np.arange(5) / 30.0 if kind == "tif" else [0.0, 0.02, 0.05, 0.09, 0.14]
    assert [frame.time for frame in frames] == pytest.approx(times)
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


@pytest.mark.parametrize(("dtype", "suffix"), [(np.uint16, "png"), (np.float32, "tif")])
def test_values_of_more_than_8_bits_need_a_range(dtype: type, suffix: str, tmp_path: Path) -> None:
    path, stack, limits = tmp_path / f"0.{suffix}", tmp_path / "0.npy", (1000.0, 4000.0)
    values = RNG.uniform(900.0, 4200.0, (24, 32, 3)).astype(dtype)
    cv2.imwrite(str(path), values[..., ::-1])
    np.save(stack, np.stack([values, values]))
    for read in (lambda: read_picture(path), lambda: open_source(str(stack))):
        with pytest.raises(UserError, match=r"16 values from 9\d\d|--value-range"):
            read()
    levels = read_picture(path, value_range=limits).astype(float)
    true = np.clip((values.astype(float) - 1000.0) / 3000.0 * 255.0, 0.0, 255.0)
    assert abs(levels - true).max() <= 0.5 + 1e-3
    frames = list(open_source(str(stack), value_range=limits).frames())
    assert np.array_equal(frames[1].image, levels)
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
    name: str, data: bytes, kind: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(data + bytes(200))
    with pytest.raises(UserError, match=f"has no pictures but {kind}, which is not read|is {kind}"):
        next(open_source(str(tmp_path)).frames())


@pytest.mark.parametrize(
    ("names", "periods"),
    [
        (["f070_l", "f080_l", "f090_l", "f100_l", "f120_l"], [0, 1, 2, 3, 5]),
        (["t1000", "t1034", "t1067", "t1101", "t1134"], [0, 1, 2, 3, 4]),  # rounded times
        ([f"{10**30 + k}" for k in (1, 2, 3, 5)], [0, 1, 2, 4]),
        ([f"{k:03d}" for k in SOME], SOME),
        (["9-58", "9-59", "10-00", "10-01", "10-03"], [0, 1, 2, 3, 4]),  # minutes, no cameras
    ],
)
def test_pictures_that_are_missing_by_their_numbers_leave_gaps_in_time(
    names: list[str], periods: list[int], tmp_path: Path
) -> None:
    written(tmp_path, *(f"{name}.png" for name in names))
    source = open_source(str(tmp_path), fps=20.0)
    frames = list(source.frames())
    assert [frame.image[0, 0, 0] for frame in frames] == list(range(len(names)))
    assert [frame.time for frame in frames] == pytest.approx([k / 20.0 for k in periods])
    if periods is SOME:
        assert source.delivery.counts["dropped"] == 4


@pytest.mark.parametrize(
    ("one", "other", "numbers", "others"),
    [
        ("{}-left", "{}-right", range(5), range(2, 9)),
        ("{:03d}_1", "{:03d}_2", range(5), range(5)),
        ("17000{}_a", "17000{}_b", range(1, 90, 7), range(3, 93, 7)),  # times
    ],
)
def test_pictures_of_two_cameras_are_not_read_one_after_the_other(
    one: str, other: str, numbers: range, others: range, tmp_path: Path
) -> None:
    for form, counted in ((one, numbers), (other, others)):
        written(tmp_path, *(f"{form.format(k)}.png" for k in counted))
    with pytest.raises(UserError, match=r"has .* beside") as refused:
        open_source(str(tmp_path))
    pattern = str(refused.value).split("'")[1]  # of one of them
    assert open_source(pattern).count in (len(numbers), len(others))
    assert open_source(f"{tmp_path}/*").count == len(numbers) + len(others)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["f_0.png", "f_0.jpg", "f_1.png", "f_1.jpg"], "has f_0 as pictures of two kinds; give o"),
        (["left/1.png"], "its folder left has: give that"),
        ([*(f"frame-{k}.png" for k in range(6)), "mask.png", "rest.png"], "has mask beside frame-"),
    ],
)
def test_a_folder_that_can_be_read_in_two_ways_is_refused(
    names: list[str], words: str, tmp_path: Path
) -> None:
    written(tmp_path, *names)
    with pytest.raises(UserError, match=words):
        open_source(str(tmp_path))
    if "mask.png" in names:
        assert open_source(f"{tmp_path}/frame-*.png").count == 6
        assert open_source(str(tmp_path), without=tmp_path / "mask.png").count == 6
