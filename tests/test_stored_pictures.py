"""Pictures of strangers: too large ones are not decoded, damaged ones are refused in silence."""

import io
import struct
import tracemalloc
import zlib
from contextlib import suppress
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from PIL import Image

from chromagrip.calibrate.lens.corners import read_image
from chromagrip.errors import UserError
from chromagrip.sources import open_source
from chromagrip.sources.picture_files import read_picture

WIDE = 30_000
KINDS = ("png", "jpg", "bmp", "tif", "webp")


def png_part(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def bomb(kind: str) -> bytes:
    """Small file that claims to be a huge picture."""
    if kind == "png":
        rows = zlib.compress(bytes(WIDE // 8 + 1) * WIDE, 9)
        head = struct.pack(">IIBBBBB", WIDE, WIDE, 1, 0, 0, 0, 0)
        return b"\x89PNG\r\n\x1a\n" + b"".join(
            png_part(*part) for part in ((b"IHDR", head), (b"IDAT", rows), (b"IEND", b""))
        )
    small = io.BytesIO()
    name = {"jpg": "JPEG", "tif": "TIFF"}.get(kind, kind.upper())
    Image.new("RGB", (16, 16)).save(small, name, lossless=True)
    data = bytearray(small.getvalue())
    if kind == "jpg":
        at = data.index(b"\xff\xc0") + 5
        data[at : at + 4] = struct.pack(">HH", WIDE, WIDE)
    elif kind == "bmp":
        data[18:26] = struct.pack("<ii", WIDE, WIDE)
    elif kind == "webp":  # 14 bits for each side, less one
        at = data.index(b"VP8L") + 9
        side = 16383
        data[at : at + 4] = struct.pack("<I", (side - 1) | (side - 1) << 14)
    else:
        for tag in (256, 257):
            at = data.index(struct.pack("<HHI", tag, 4, 1)) + 8
            data[at : at + 4] = struct.pack("<I", WIDE)
    return bytes(data)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("as_png", [False, True])
def test_a_huge_picture_is_not_decoded(kind: str, as_png: bool, tmp_path: Path) -> None:
    """Whatever its name says."""
    path = tmp_path / f"bomb.{'png' if as_png else kind}"
    path.write_bytes(bomb(kind))
    tracemalloc.start()
    for read in (read_picture, read_image):
        with pytest.raises(UserError, match=r"megapixels; allowed: 64; .*--max-megapixels"):
            read(path)
    assert tracemalloc.get_traced_memory()[1] < 2e7
    tracemalloc.stop()


@pytest.mark.parametrize("kind", ["png", "jpg"])
def test_the_limit_is_chosen(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"0.{kind}"
    cv2.imwrite(str(path), np.zeros((100, 200, 3), np.uint8))
    assert read_picture(path, 0.02).shape == (100, 200, 3)
    with pytest.raises(UserError, match="200×100 pixels"):
        read_picture(path, 0.019)
    with pytest.raises(UserError, match="200×100 pixels"):
        next(open_source(str(tmp_path), max_megapixels=0.019).frames())


def test_a_huge_video_is_not_decoded(tmp_path: Path) -> None:
    path = tmp_path / "wide.mkv"
    with av.open(str(path), "w") as video:
        stream = video.add_stream("ffv1", rate=10)
        stream.width, stream.height, stream.pix_fmt = 400, 300, "gray"
        frame = av.VideoFrame.from_ndarray(np.zeros((300, 400), np.uint8), format="gray")
        video.mux(stream.encode(frame) + stream.encode(None))
    assert next(open_source(str(path)).frames()).image.shape == (300, 400, 3)
    with pytest.raises(UserError, match=r"megapixels"):
        open_source(str(path), max_megapixels=0.1)


def test_a_pipe_that_claims_much_is_refused(tmp_path: Path) -> None:
    pipe = tmp_path / "frames"
    for claim in ((10**6, 10**6, 3), (10**12,), (1, 1, 10**12), (2**62, 8, 3)):
        head = io.BytesIO()
        about = {"descr": "|u1", "fortran_order": False, "shape": claim}
        np.save(head, np.float64(0.0))
        np.lib.format.write_array_header_1_0(head, about)
        pipe.write_bytes(head.getvalue())
        with pytest.raises(UserError, match=r"^pipe:"):
            next(open_source(f"pipe:{pipe}").frames())


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_pictures_are_read_or_refused_in_silence(
    kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Libraries write to the terminal below Python; capfd sees that too."""
    rng = np.random.default_rng(len(kind))
    whole = io.BytesIO()
    name = {"jpg": "JPEG", "tif": "TIFF"}.get(kind, kind.upper())
    image = Image.fromarray(rng.integers(0, 256, (24, 32, 3)).astype(np.uint8))
    image.save(whole, name, **({"compression": "tiff_lzw"} if kind == "tif" else {}))
    path = tmp_path / f"damaged.{kind}"
    for _ in range(60):
        data = bytearray(whole.getvalue())
        for at in rng.integers(0, len(data), rng.integers(1, 8)):
            data[at] = rng.integers(0, 256)
        path.write_bytes(data[: rng.integers(1, len(data) + 1)] if rng.random() < 0.3 else data)
        for read in (read_picture, read_image):
            with suppress(UserError):
                read(path)
    assert capfd.readouterr() == ("", "")


def test_a_flipped_bit_of_a_png_is_found(tmp_path: Path) -> None:
    """Pillow alone reads over the checksums of the pixels."""
    rng = np.random.default_rng(5)
    whole = cv2.imencode(".png", rng.integers(0, 256, (40, 40, 3)).astype(np.uint8))[1].tobytes()
    path = tmp_path / "flipped.png"
    for at in rng.integers(8, len(whole) - 12, 40):
        data = bytearray(whole)
        data[at] ^= 1 << int(rng.integers(0, 8))
        path.write_bytes(data)
        with pytest.raises(UserError, match=r"cannot be read|transparent|16 values|megapixels"):
            read_picture(path)


@pytest.mark.parametrize("coding", [(".png", []), (".jpg", [1, 60]), (".jpg", [1, 95, 2, 1])])
def test_pixels_are_those_of_opencv(coding: tuple[str, list[int]], tmp_path: Path) -> None:
    """Which read them before."""
    rng = np.random.default_rng(6)
    path = tmp_path / f"picture{coding[0]}"
    for shape in ((61, 47, 3), (61, 47)):
        noise = cv2.GaussianBlur(rng.uniform(0, 255, shape), (0, 0), 1.0)
        cv2.imwrite(str(path), noise.astype(np.uint8), coding[1])
        assert np.array_equal(read_picture(path), cv2.imread(str(path))[..., ::-1])
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert abs(read_image(path).astype(int) - grey).max() <= (coding[0] == ".png")
