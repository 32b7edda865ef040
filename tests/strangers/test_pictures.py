"""Pictures, videos, arrays, lists and bags of strangers, as sources of frames."""

import io
import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from random import Random

import av
import cv2
import numpy as np
import pytest
from PIL import Image

from chromagrip.calibrate.lens.corners import read_image
from chromagrip.errors import UserError
from chromagrip.render import Frame
from chromagrip.sources import open_source, pipe_bytes
from chromagrip.sources.picture_files import read_picture

from ..sources.test_bags import bag, raw
from .damages import harmed
from .judged import Judge, Trap, few_and_many, repeated

KINDS = {"png": "PNG", "jpg": "JPEG", "bmp": "BMP", "tif": "TIFF", "webp": "WEBP"}
WIDE = 30_000
PICTURES = np.random.default_rng(5).integers(0, 256, (3, 24, 32, 3)).astype(np.uint8)


def saved(path: Path) -> None:
    more = {"compression": "tiff_lzw"} if path.suffix == ".tif" else {}
    Image.fromarray(PICTURES[0]).save(path, KINDS[path.suffix[1:]], lossless=True, **more)


def video(path: Path, codec: str, form: str) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt = 32, 24, form
        for picture in PICTURES:
            frame = av.VideoFrame.from_ndarray(picture)
            container.mux(stream.encode(frame.reformat(format=form)))
        container.mux(stream.encode(None))


def good(folder: Path) -> None:
    """Good files of each kind."""
    for kind in KINDS:
        saved(folder / f"one.{kind}")
    first, *others = map(Image.fromarray, PICTURES)
    first.save(folder / "pages.tiff", save_all=True, append_images=others)
    video(folder / "mkv.mkv", "ffv1", "bgr0")
    video(folder / "mp4.mp4", "mpeg4", "yuv420p")
    np.save(folder / "array.npy", PICTURES)
    np.savez(folder / "array.npz", images=PICTURES, times=0.1 * np.arange(3))
    frames = [Frame(image=image, time=0.1 * k) for k, image in enumerate(PICTURES)]
    (folder / "pipe").write_bytes(b"".join(map(pipe_bytes, frames)))
    messages = [(9.0 + k, raw(image, "bgr8", 5.0 + k)) for k, image in enumerate(PICTURES)]
    bag(folder / "bag", image=messages)
    (folder / "shots").mkdir()
    for k in range(2):
        saved(folder / f"shots/{k}.png")
    (folder / "shots/frames.csv").write_text("time_s,file\n0.5,1.png\n0.75,0.png\n")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    good(folder)
    return folder


def read(name: str) -> int:
    source = open_source(f"pipe:given/{name}" if name == "pipe" else f"given/{name}")
    if name.startswith("one"):
        read_image(Path("given", name))
    return len(list(source.frames()))


@few_and_many(60, 1500)
def test_damaged_pictures_are_read_or_refused_in_silence(
    judged: Judge, whole: Path, count: int
) -> None:
    names = sorted(path.name for path in whole.iterdir())

    def check(draw: Random) -> None:
        name = draw.choice(names)
        with judged.files(whole) as folder:
            path = folder / name
            if path.is_dir():
                path = draw.choice(sorted(path.iterdir()))
            harmed(path, draw)
            if name == "pipe" and path.is_fifo():  # which is read until it ends
                return
            judged.call(lambda: read(name), names="given")
            if draw.random() < 0.03:
                judged.command("detect", f"given/{name}", "--json", names="given")

    with judged.files(whole):
        for name in names:
            assert judged.call(lambda name=name: read(name)) in (1, 2, 3), name
    repeated(check, count)
    assert judged.refused > count // 4


def png_part(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def bomb(path: Path) -> None:
    """Small file that claims to be a huge picture."""
    if path.suffix == ".png":
        rows = zlib.compress(bytes(WIDE // 8 + 1) * 1000)
        head = struct.pack(">IIBBBBB", WIDE, WIDE, 1, 0, 0, 0, 0)
        parts = ((b"IHDR", head), (b"IDAT", rows), (b"IEND", b""))
        path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(png_part(*part) for part in parts))
        return
    Image.new("RGB", (16, 16)).save(path, KINDS[path.suffix[1:]], lossless=True)
    data = bytearray(path.read_bytes())
    if path.suffix == ".jpg":
        at = data.index(b"\xff\xc0") + 5
        data[at : at + 4] = struct.pack(">HH", WIDE, WIDE)
    elif path.suffix == ".bmp":
        data[18:26] = struct.pack("<ii", WIDE, WIDE)
    elif path.suffix == ".webp":  # 14 bits for each side, less one
        at = data.index(b"VP8L") + 9
        data[at : at + 4] = struct.pack("<I", 16382 | 16382 << 14)
    else:
        for tag in (256, 257):
            at = data.index(struct.pack("<HHI", tag, 4, 1)) + 8
            data[at : at + 4] = struct.pack("<I", WIDE)
    path.write_bytes(data)


def claim(shape: tuple[int, ...], kind: str = "|u1") -> bytes:
    """Header of an array that claims a shape, after a time."""
    head = io.BytesIO()
    np.save(head, np.float64(0.0))
    about = {"descr": kind, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(head, about)
    return head.getvalue()


def written(data: bytes) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(data)


LIST = b"ffconcat version 1.0\nfile '../outside/secret.mkv'\n"
#: Attacks by the names of their files: what writes one, and what is said.
ATTACKS: dict[str, tuple[Callable[[Path], object], str]] = {
    **{f"bomb.{kind}": (bomb, "megapixels; allowed: 64") for kind in KINDS},
    "list.mkv": (written(LIST), "cannot be read as a video"),
    "list.mp4": (written(b"#EXTM3U\n#EXTINF:1\n/etc/hostname\n"), "list.mp4"),
    "text.mp4": (written(b"root:x:0:0"), "text.mp4"),
    "empty.mp4": (written(b""), "is empty"),
    "claims.npy": (written(claim((1, 10**6, 10**6, 3))[-128:]), "megapixels"),
    "trap.npy": (lambda path: np.save(path, np.array([Trap()])), "has object (1,)"),
    "trap.npz": (lambda path: np.savez(path, images=np.array([Trap()])), "has object (1,)"),
    "pipe-large": (written(claim((10**6, 10**6, 3))), "pipe:"),
    "pipe-long": (written(claim((2**62, 8, 3))), "pipe:"),
    "pipe-trap": (written(claim((2, 2, 3), "|O")), "pipe:"),
}  # fmt: skip


@pytest.mark.parametrize("name", ATTACKS)
def test_each_kind_of_attack_is_a_sentence(judged: Judge, whole: Path, name: str) -> None:
    """Also under another name, for pictures."""
    write, told = ATTACKS[name]
    (judged.outside / "secret.mkv").write_bytes((whole / "mkv.mkv").read_bytes())
    with judged.files() as folder:
        write(folder / name)
        kind = "pipe:" if name.startswith("pipe") else ""
        judged.call(lambda: list(open_source(f"{kind}given/{name}").frames()), names=told)
        assert judged.refused == 1
        if name.startswith("bomb"):
            (folder / name).rename(folder / "other.jpg")
            for reader in (read_picture, read_image):
                judged.call(lambda reader=reader: reader(folder / "other.jpg"), names=told)
            judged.command("detect", "given/other.jpg", names="--max-megapixels")
            assert judged.refused == 4


def test_what_has_no_end_is_a_sentence(judged: Judge) -> None:
    for name in ("0.png", "0.npy", "0.mkv"):
        with judged.files() as folder:
            (folder / name).symlink_to("/dev/zero")
            judged.call(lambda name=name: list(open_source(f"given/{name}").frames()), names=name)
            os.mkfifo(folder / "1.png")
            judged.call(lambda: list(open_source("given").frames()), names="is no file")
            judged.call(lambda: read_image(Path("given/1.png")), names="is no file")
    with judged.files() as folder:
        (folder / "bag").mkdir()
        (folder / "bag/metadata.yaml").write_text("rosbag2_bagfile_information:\n")
        os.mkfifo(folder / "bag/bag.mcap")
        judged.call(lambda: list(open_source("given/bag").frames()), names="bag.mcap is no file")
        os.mkfifo(folder / "metadata.yaml")
        judged.call(lambda: list(open_source("given").frames()))
    assert judged.refused == 11


def test_the_limit_of_a_size_is_chosen(tmp_path: Path, whole: Path) -> None:
    for kind in ("png", "jpg"):
        path = whole / f"one.{kind}"
        assert read_picture(path, 768e-6).shape == (24, 32, 3)
        with pytest.raises(UserError, match="32×24 pixels"):
            read_picture(path, 767e-6)
    for name in ("shots", "mkv.mkv", "array.npy"):
        open_source(str(whole / name), max_megapixels=768e-6)
        with pytest.raises(UserError, match=r"32×24 pixels|megapixels"):
            next(open_source(str(whole / name), max_megapixels=767e-6).frames())


def test_a_flipped_bit_of_a_png_is_found(tmp_path: Path) -> None:
    """Pillow alone reads over the checksums of the pixels."""
    rng = np.random.default_rng(5)
    whole = cv2.imencode(".png", PICTURES[0])[1].tobytes()
    path = tmp_path / "flipped.png"
    for at in rng.integers(8, len(whole) - 12, 40):
        data = bytearray(whole)
        data[at] ^= 1 << int(rng.integers(0, 8))
        path.write_bytes(data)
        with pytest.raises(UserError, match=r"cannot be read|transparent|16 values|megapixels"):
            read_picture(path)
