"""Compiled Huffman coding of a picture's rows. `png.py` documents the use."""

import numpy as np
from numpy.typing import NDArray

from ..compiled import njit

Bytes = NDArray[np.uint8]

#: Number of DEFLATE's literals with the end of a block (RFC 1951).
_SYMBOLS = 257
#: Symbol of the end of a block (RFC 1951).
_END = 256
#: Longest code that DEFLATE allows [bits] (RFC 1951).
_LONGEST = 15
#: PNG's filter that keeps differences from the row above (PNG specification).
_UP = 2
#: Modulus of Adler's checksum (RFC 1950).
_BASE = 65521


@njit()
def deflate_rows(rows: Bytes, block: int, out: NDArray[np.uint32]) -> tuple[int, int]:
    """Write DEFLATE blocks of filtered rows, without matches; bytes written, and Adler's checksum.

    Parameters
    ----------
    rows: of the picture, shape (H, W)
    block: rows of a block, each of which has a code of its own
    out: to write to, little-endian
    """
    height, width = rows.shape
    data = np.empty(block * (width + 1), dtype=np.uint8)
    counts = np.empty((4, _SYMBOLS), dtype=np.int64)
    codes, lengths = np.empty(_SYMBOLS, dtype=np.uint64), np.empty(_SYMBOLS, dtype=np.int64)
    low, high = 1, 0
    writer = np.zeros(3, dtype=np.uint64)  # bits that wait, how many, and words written
    for first in range(0, height, block):
        last = min(first + block, height)
        for y in range(first, last):
            line = data[(y - first) * (width + 1) : (y - first + 1) * (width + 1)]
            line[0] = _UP
            now, above, part = rows[y], rows[y - 1], line[1:]
            if y == 0:
                for j in range(width):
                    part[j] = now[j]
            else:
                for j in range(width):
                    part[j] = now[j] - above[j]
            total, weighted = np.int64(0), np.int64(0)
            for j in range(width + 1):
                total += np.int64(line[j])
                weighted += np.int64(width + 1 - j) * np.int64(line[j])
            high = (high + (width + 1) * low + int(weighted)) % _BASE
            low = (low + int(total)) % _BASE
        used = data[: (last - first) * (width + 1)]
        # Four tables: the same one would wait for itself where bytes repeat.
        counts[:] = 0
        whole = len(used) // 4 * 4
        for i in range(0, whole, 4):
            counts[0, used[i]] += 1
            counts[1, used[i + 1]] += 1
            counts[2, used[i + 2]] += 1
            counts[3, used[i + 3]] += 1
        for i in range(whole, len(used)):
            counts[0, used[i]] += 1
        for s in range(_END):
            counts[0, s] += counts[1, s] + counts[2, s] + counts[3, s]
        counts[0, _END] = 1
        code_lengths(counts[0], lengths)
        _canonical(lengths, codes)
        _header(lengths, last == height, writer, out)
        _symbols(used, codes, lengths, writer, out)
        _put(codes[_END], lengths[_END], writer, out)
    bits, waiting, words = writer
    out[np.int64(words)] = np.uint32(bits)
    return 4 * int(words) + (int(waiting) + 7) // 8, (high << 16) | low


@njit()
def code_lengths(counts: NDArray[np.int64], lengths: NDArray[np.int64]) -> None:
    """Huffman's code lengths, 0 for unused symbols; counts are halved until no code is too long."""
    weights = np.empty(2 * len(counts), dtype=np.int64)
    parents = np.empty(2 * len(counts), dtype=np.int64)
    depths = np.empty(2 * len(counts), dtype=np.int64)
    order = np.empty(len(counts), dtype=np.int64)
    halvings, deepest = 0, _LONGEST + 1
    while deepest > _LONGEST:
        leaves = 0
        for s in range(len(counts)):
            lengths[s] = 0
            if counts[s]:
                order[leaves], weights[leaves] = s, max(counts[s] >> halvings, 1)
                leaves += 1
        _sort(weights[:leaves], order[:leaves])
        # Joined nodes come in the order of their weights: two queues, of leaves and of those.
        leaf, joined, end = 0, leaves, leaves
        while end < 2 * leaves - 1:
            weights[end] = 0
            for _ in range(2):
                if leaf < leaves and (joined == end or weights[leaf] <= weights[joined]):
                    child = leaf
                    leaf += 1
                else:
                    child = joined
                    joined += 1
                parents[child] = end
                weights[end] += weights[child]
            end += 1
        depths[end - 1], deepest = 0, 0
        for k in range(end - 2, -1, -1):
            depths[k] = depths[parents[k]] + 1
            deepest = max(deepest, depths[k])
        halvings += 1
    for k in range(leaves):
        lengths[order[k]] = depths[k]


@njit()
def _sort(keys: NDArray[np.int64], along: NDArray[np.int64]) -> None:
    """Sort keys in place, and what goes along with them: Shell's sort compiles in no time."""
    gap = 1
    while gap < len(keys) // 3:
        gap = 3 * gap + 1
    while gap:
        for i in range(gap, len(keys)):
            key, value, j = keys[i], along[i], i
            while j >= gap and keys[j - gap] > key:
                keys[j], along[j] = keys[j - gap], along[j - gap]
                j -= gap
            keys[j], along[j] = key, value
        gap //= 3


@njit()
def _canonical(lengths: NDArray[np.int64], codes: NDArray[np.uint64]) -> None:
    """Codes of these lengths, first bit lowest."""
    count = np.zeros(_LONGEST + 2, dtype=np.int64)
    for length in lengths:
        if length:
            count[length + 1] += 1
    code = np.zeros(_LONGEST + 2, dtype=np.int64)
    for length in range(1, _LONGEST + 1):
        code[length] = (code[length - 1] + count[length]) << 1
    for s in range(len(lengths)):
        value, turned = code[lengths[s]], 0
        for _ in range(lengths[s]):
            turned = (turned << 1) | (value & 1)
            value >>= 1
        code[lengths[s]] += 1
        codes[s] = np.uint64(turned)


@njit()
def _put(
    value: np.uint64, length: int, writer: NDArray[np.uint64], out: NDArray[np.uint32]
) -> None:
    """Append up to 32 bits."""
    writer[0] |= np.uint64(value) << writer[1]
    writer[1] += np.uint64(length)
    if writer[1] >= np.uint64(32):
        out[np.int64(writer[2])] = np.uint32(writer[0] & np.uint64(0xFFFFFFFF))
        writer[0] >>= np.uint64(32)
        writer[1] -= np.uint64(32)
        writer[2] += np.uint64(1)


@njit()
def _header(
    lengths: NDArray[np.int64],
    last: bool,
    writer: NDArray[np.uint64],
    out: NDArray[np.uint32],
) -> None:
    """Begin a block: its code's lengths, and that no distance is used, each in four bits.

    Parameters
    ----------
    lengths: of the code, 0 for unused symbols
    last: whether this is the last block
    """
    _put(np.uint64(1 if last else 0), 1, writer, out)
    _put(np.uint64(2), 2, writer, out)  # a code of its own
    _put(np.uint64(0), 5, writer, out)  # 257 literals
    _put(np.uint64(0), 5, writer, out)  # one distance
    _put(np.uint64(15), 4, writer, out)
    # Lengths of the lengths' code: three repeats, which are not used, then 0 to 15, four bits each.
    for k in range(19):
        _put(np.uint64(0 if k < 3 else 4), 3, writer, out)
    for s in range(len(lengths) + 1):
        value = lengths[s] if s < len(lengths) else 0
        turned = (value & 1) << 3 | (value & 2) << 1 | (value & 4) >> 1 | (value & 8) >> 3
        _put(np.uint64(turned), 4, writer, out)


@njit()
def _symbols(
    data: Bytes,
    codes: NDArray[np.uint64],
    lengths: NDArray[np.int64],
    writer: NDArray[np.uint64],
    out: NDArray[np.uint32],
) -> None:
    """Append the codes of bytes, two at a time: with 31 that wait they fit into 64 bits."""
    size = np.empty(256, dtype=np.uint64)
    for s in range(256):
        size[s] = np.uint64(lengths[s])
    bits, waiting, word = writer[0], writer[1], np.int64(writer[2])
    for i in range(0, len(data) // 2 * 2, 2):
        first, second = data[i], data[i + 1]
        both = codes[first] | codes[second] << size[first]
        bits |= both << waiting
        waiting += size[first] + size[second]
        # Written always, counted where it is full.
        out[word] = np.uint32(bits & np.uint64(0xFFFFFFFF))
        full = waiting >> np.uint64(5)
        word += np.int64(full)
        bits >>= full << np.uint64(5)
        waiting &= np.uint64(31)
    writer[0], writer[1], writer[2] = bits, waiting, np.uint64(word)
    if len(data) % 2:
        _put(codes[data[-1]], lengths[data[-1]], writer, out)
