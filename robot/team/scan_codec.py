"""Scans as journal entries carry them: quantised, delta coded, deflated.

Format: each beam becomes a code: 0 where the beam says nothing, 1 where nothing was hit, else
2 + round(range / resolution). Differences between neighbouring codes are one byte each, −128
being an escape for what does not fit; the escaped differences follow as little-endian int32.
Layout before deflate (raw, no header): number of beams (uint16), the bytes, the escaped ones.
The error of a range is at most half the resolution.
"""

import struct
import zlib

import numpy as np

from protocol.errors import MalformedMessageError
from protocol.pose import FloatArray

RESOLUTION_M = 0.01
MAX_BEAMS = 4096
NOTHING_KNOWN, NOTHING_HIT, FIRST_RANGE = 0, 1, 2
ESCAPE = -128
MAX_CODE = 1 << 20


def compress_scan(ranges: FloatArray) -> bytes:
    """Ranges (n) in metres, +inf for no hit, NaN for no knowledge."""
    codes = np.zeros(len(ranges), dtype=np.int64)
    hits = np.isfinite(ranges)
    codes[hits] = FIRST_RANGE + np.rint(ranges[hits] / RESOLUTION_M).astype(np.int64)
    codes[np.isinf(ranges)] = NOTHING_HIT
    deltas = np.diff(codes, prepend=0)
    wide = np.abs(deltas) > 127
    small = np.where(wide, ESCAPE, deltas).astype(np.int8)
    raw = struct.pack("<H", len(ranges)) + small.tobytes() + deltas[wide].astype("<i4").tobytes()
    deflate = zlib.compressobj(9, zlib.DEFLATED, -15)
    return deflate.compress(raw) + deflate.flush()


def decompress_scan(data: bytes) -> FloatArray:
    """The ranges (n) in a compressed scan. Raises MalformedMessageError on anything else."""
    limit = 2 + MAX_BEAMS * 5
    inflate = zlib.decompressobj(-15)
    try:
        raw = inflate.decompress(data, limit + 1)
    except zlib.error as error:
        raise MalformedMessageError("scan", str(error)) from error
    if not inflate.eof or inflate.unused_data or not 2 <= len(raw) <= limit:
        raise MalformedMessageError("scan", "not one deflated scan")
    (beams,) = struct.unpack_from("<H", raw)
    if beams > MAX_BEAMS or len(raw) < 2 + beams:
        raise MalformedMessageError("scan", f"{beams} beams in {len(raw)} bytes")
    deltas = np.frombuffer(raw, dtype=np.int8, count=beams, offset=2).astype(np.int64)
    wide = deltas == ESCAPE
    if len(raw) != 2 + beams + 4 * int(wide.sum()):
        raise MalformedMessageError("scan", "the escaped differences do not fit")
    deltas[wide] = np.frombuffer(raw, dtype="<i4", offset=2 + beams)
    codes = np.cumsum(deltas)
    if beams and not (codes.min() >= 0 and codes.max() <= MAX_CODE):
        raise MalformedMessageError("scan", "a range is out of bounds")
    ranges = (codes - FIRST_RANGE) * RESOLUTION_M
    ranges[codes == NOTHING_KNOWN] = np.nan
    ranges[codes == NOTHING_HIT] = np.inf
    return np.asarray(ranges, dtype=np.float64)
