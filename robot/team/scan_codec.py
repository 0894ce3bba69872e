"""Scans as journal entries carry them: quantised as coarsely as range finders err, and coded as
differences.

Format: the number of beams (uint16, little-endian), then one whole number for each beam as
`scan_kernels.encode` writes them: 0 where the beam says nothing, 1 where nothing was hit, else
2 + round(u(r)) with u(r) = ln(1 + b r / a) / b. Steps of u are a + b r wide, a = 2.5 cm and
b = 1.25 %: two and a half times what a common range finder errs by (σ = 1 cm + 0.5 % of the range).
The error of a range is at most half a step, which adds half to the variance of such a sensor.
"""

import struct

import numpy as np

from protocol.errors import MalformedMessageError
from protocol.pose import FloatArray
from robot.team import scan_kernels

STEP_M, STEP_SHARE = 0.025, 0.0125
MAX_BEAMS = 4096
NOTHING_KNOWN, NOTHING_HIT, FIRST_RANGE = 0, 1, 2
MAX_CODE = 4096
MAX_BYTES_A_BEAM = 8


def compress_scan(ranges: FloatArray) -> bytes:
    """Ranges (n) in metres, +inf for no hit, NaN for no knowledge."""
    codes = np.zeros(len(ranges), dtype=np.int64)
    hits = np.isfinite(ranges)
    steps = np.log1p(STEP_SHARE / STEP_M * ranges[hits]) / STEP_SHARE
    codes[hits] = FIRST_RANGE + np.rint(steps).astype(np.int64)
    codes[np.isinf(ranges)] = NOTHING_HIT
    out = np.zeros(MAX_BYTES_A_BEAM * len(codes), dtype=np.uint8)
    size = scan_kernels.encode(codes, out)
    return struct.pack("<H", len(codes)) + out[:size].tobytes()


def decompress_scan(data: bytes) -> FloatArray:
    """The ranges (n) in a compressed scan. Raises MalformedMessageError on anything else."""
    if len(data) < 2:
        raise MalformedMessageError("scan", "the number of beams is missing")
    (beams,) = struct.unpack_from("<H", data)
    if beams > MAX_BEAMS:
        raise MalformedMessageError("scan", f"{beams} beams are too many")
    codes = np.zeros(beams, dtype=np.int64)
    bits = np.frombuffer(data, dtype=np.uint8, offset=2).copy()
    if not scan_kernels.decode(bits, codes):
        raise MalformedMessageError("scan", f"not {beams} beams and nothing else")
    if beams and not (codes.min() >= 0 and codes.max() <= MAX_CODE):
        raise MalformedMessageError("scan", "a range is out of bounds")
    ranges = np.expm1((codes - FIRST_RANGE) * STEP_SHARE) * STEP_M / STEP_SHARE
    ranges[codes == NOTHING_KNOWN] = np.nan
    ranges[codes == NOTHING_HIT] = np.inf
    return np.asarray(ranges, dtype=np.float64)
