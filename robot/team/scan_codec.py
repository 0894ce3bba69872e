"""Scans as whole numbers, as coarse as range finders err, and those as bytes.

Quantised, a beam is 0 where it says nothing, 1 where nothing was hit, else 2 + round(u(r)) with
u(r) = ln(1 + b r / a) / b. Steps of u are a + b r wide, a = 2.5 cm and b = 1.25 %: two and a half
times what a common range finder errs by (σ = 1 cm + 0.5 % of the range). The error of a range is at
most half a step, which adds half to the variance of such a sensor.

On the radio the numbers are coded as `scan_code_kernels` says, by what was foreseen for each of
them (`robot.team.log_context`). In memory they are kept so that they can be read in a moment: their
number (uint16, little-endian), then what `scan_kernels.encode` writes.
"""

import struct

import numpy as np
import numpy.typing as npt

from protocol.errors import MalformedMessageError
from protocol.pose import FloatArray
from robot.team import scan_code_kernels, scan_kernels

STEP_M, STEP_SHARE = 0.025, 0.0125
MAX_BEAMS = 4096
NOTHING_KNOWN, NOTHING_HIT, FIRST_RANGE = 0, 1, 2
MAX_CODE = scan_code_kernels.CODES - 1  # 1.1 km: what is farther comes out as that
MAX_BYTES_A_BEAM = 8

Codes = npt.NDArray[np.int64]


def quantise(ranges: FloatArray) -> Codes:
    """Ranges (n) in metres, +inf for no hit, NaN for no knowledge, as numbers (n)."""
    codes = np.full(len(ranges), NOTHING_KNOWN, dtype=np.int64)
    hits = np.isfinite(ranges)
    steps = np.log1p(STEP_SHARE / STEP_M * ranges[hits]) / STEP_SHARE
    codes[hits] = np.minimum(FIRST_RANGE + np.rint(steps).astype(np.int64), MAX_CODE)
    codes[np.isinf(ranges)] = NOTHING_HIT
    return codes


def ranges_of(codes: Codes) -> FloatArray:
    """The ranges (n) that numbers stand for."""
    ranges = np.expm1((codes - FIRST_RANGE) * STEP_SHARE) * STEP_M / STEP_SHARE
    ranges[codes == NOTHING_KNOWN] = np.nan
    ranges[codes == NOTHING_HIT] = np.inf
    return np.asarray(ranges, dtype=np.float64)


def encode_scan(codes: Codes, foreseen: FloatArray) -> bytes:
    """The bytes for numbers (n) where `foreseen` (n) was expected; NaN is no expectation."""
    out = np.zeros(2 * len(codes) + 8, dtype=np.uint8)
    size = scan_code_kernels.encode(codes, foreseen, out)
    return out[:size].tobytes()


def decode_scan(data: bytes, foreseen: FloatArray) -> Codes:
    """The numbers (n) in such bytes. Raises MalformedMessageError on what `encode_scan` does not
    write for any numbers."""
    codes = np.zeros(len(foreseen), dtype=np.int64)
    scan_code_kernels.decode(np.frombuffer(data, dtype=np.uint8).copy(), foreseen, codes)
    if encode_scan(codes, foreseen) != data:
        raise MalformedMessageError("scan", f"not {len(codes)} beams and nothing else")
    return codes


def store(codes: Codes) -> bytes:
    """Numbers (n) as they are kept in memory."""
    out = np.zeros(MAX_BYTES_A_BEAM * len(codes), dtype=np.uint8)
    size = scan_kernels.encode(codes, out)
    return struct.pack("<H", len(codes)) + out[:size].tobytes()


def recall(data: bytes) -> Codes:
    """The numbers (n) that are kept so."""
    (beams,) = struct.unpack_from("<H", data)
    codes = np.zeros(beams, dtype=np.int64)
    scan_kernels.decode(np.frombuffer(data, dtype=np.uint8, offset=2).copy(), codes)
    return codes
