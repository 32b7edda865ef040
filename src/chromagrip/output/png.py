"""Lossless pictures, fast: PNG files whose rows are written as differences from the row above.

Noise cannot be packed, so that time is all that can be saved: matches are not looked for, bytes get
Huffman codes. The same picture gives the same bytes, always; of ISA-L's matches, which take longer,
one in some ten thousand pictures was another from run to run.
"""

import struct
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from .png_kernels import deflate_rows


def encode_png(image: NDArray[np.uint8]) -> bytes:
    """PNG file of a picture, 8 bits a channel, shape (H, W) or (H, W, 3)."""
    height, width = image.shape[:2]
    rows = np.ascontiguousarray(image).reshape(height, -1)
    block_size = 1 << 16  # bytes that share a code
    block = max(1, block_size // (rows.shape[1] + 1))
    # At most 15 bits a byte, and some for each block's code.
    out = np.empty(rows.size // 2 + height + 64 * (height // block + 2), dtype=np.uint32)
    size, adler = deflate_rows(rows, block, out)
    colour = 0 if image.ndim == 2 else 2  # types of PNG: of one channel, and of three
    header = struct.pack(">IIBBBBB", width, height, 8, colour, 0, 0, 0)
    zlib_header = b"\x78\x01"  # of a window of 32 kB, fastest
    packed = b"".join([zlib_header, out.view(np.uint8)[:size].tobytes(), struct.pack(">I", adler)])
    parts = [b"\x89PNG\r\n\x1a\n"]
    for kind, data in ((b"IHDR", header), (b"IDAT", packed), (b"IEND", b"")):
        check = crc32(data, crc32(kind))
        parts += [struct.pack(">I", len(data)), kind, data, struct.pack(">I", check)]
    return b"".join(parts)
