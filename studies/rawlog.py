"""Rawlogs, the logs of MRPT: made of a CARMEN log by its converter, and what that leaves undone.

An object is written as its class's name behind the name's length + 128, a byte of version, its
members (little-endian) and 0x88. https://docs.mrpt.org, page "Rawlog file format".
"""

import gzip
import math
import re
import struct
import time
from itertools import pairwise

from protocol.config import LidarConfig
from protocol.errors import EarshotError
from protocol.pose import FloatArray

TICKS_PER_S = 1e7  # of MRPT's clock
EPOCH_S = 11_644_473_600.0  # it counts since 1601
END = b"\x88"
ODOMETRY = b"\x9fmrpt::obs::CObservationOdometry"
SCAN = b"\xa2mrpt::obs::CObservation2DRangeScan"
MOUNT = b"\x94mrpt::poses::CPose3D\x03"
POSE = b"\x94mrpt::poses::CPose2D\x01"
# MRPT's own defaults of how sure odometry is: the Gaussian model's a1 to a4 and least deviations,
# then what the other model would have.
GAUSSIAN = (0.01, math.degrees(0.001), math.radians(1.0), 0.05, 0.01, math.radians(0.2))
SAMPLED = (0.05, math.radians(4.0), 0.01, math.degrees(0.0001), 0.001, math.radians(0.05))


class RawlogError(EarshotError):
    """A converted log that is not what its converter makes of a CARMEN log with FLASER lines."""


def mended(converted: bytes, stamps: FloatArray, lidar: LidarConfig) -> bytes:
    """The log with each scan and its odometry at the scan's own stamp (n, s) and its beams where
    they point. The converter gives all the same stamp, by which icp-slam matches nothing, and has
    scans of one beam a degree span a quarter turn. Raises RawlogError."""
    data = bytearray(gzip.decompress(converted))
    shared = _shared_stamp(data, 2 * len(stamps))
    (first,) = struct.unpack("<Q", shared)
    for index, found in enumerate(re.finditer(re.escape(shared), bytes(data))):
        after = round((stamps[index // 2] - stamps[0]) * TICKS_PER_S)
        struct.pack_into("<Q", data, found.start(), first + after)
    span = lidar.field_of_view_rad
    centre = lidar.angle_min_rad + 0.5 * span  # of MRPT's scans always the sensor's x axis
    cos, sin = math.cos(centre), math.sin(centre)
    for found in re.finditer(SCAN, bytes(data)):
        struct.pack_into("<f", data, found.end() + 1, span)
        turned = data.index(MOUNT, found.end()) + len(MOUNT) + 24  # after x, y and z
        struct.pack_into("<5d", data, turned, cos, -sin, 0.0, sin, cos)
    return gzip.compress(bytes(data), 1)


def paired(observations: bytes) -> bytes:
    """A log of single observations as one of actions and sensory frames, which rbpf-slam needs:
    for each scan the odometry's increment since the one before, and the scan alone."""
    data = gzip.decompress(observations)
    starts = [found.start() for found in re.finditer(ODOMETRY + b"|" + SCAN, data)]
    pairs = []
    before = now = None
    for start, end in pairwise([*starts, len(data)]):
        item = data[start:end]
        if item.startswith(ODOMETRY):
            now = struct.unpack_from("<3d", item, item.index(POSE) + len(POSE))
        elif now is not None:
            pairs += [_action(_increment(before or now, now)), _frame(item)]
            before = now
    return gzip.compress(b"".join(pairs), 1)


def _shared_stamp(data: bytearray, count: int) -> bytes:
    """The eight bytes of the stamp that all observations of a converted log have."""
    now = (time.time() + EPOCH_S) * TICKS_PER_S
    for at in range(len(data) - 8):
        (ticks,) = struct.unpack_from("<Q", data, at)
        if abs(ticks - now) < 3600.0 * TICKS_PER_S:
            stamp = bytes(data[at : at + 8])
            if data.count(stamp) == count:
                return stamp
    raise RawlogError(
        f"the converted log has no {count} observations with one stamp: give a CARMEN log with "
        "FLASER lines alone"
    )


def _increment(before: tuple[float, ...], now: tuple[float, ...]) -> tuple[float, float, float]:
    east, north = now[0] - before[0], now[1] - before[1]
    cos, sin = math.cos(before[2]), math.sin(before[2])
    turn = math.remainder(now[2] - before[2], math.tau)
    return cos * east + sin * north, cos * north - sin * east, turn


def _named(name: str, version: int, members: bytes) -> bytes:
    return bytes([128 + len(name)]) + name.encode() + bytes([version]) + members + END


def _action(increment: tuple[float, float, float]) -> bytes:
    """A collection of one movement, with neither velocities nor encoders nor stamp."""
    movement = (
        struct.pack("<I", 0)  # of odometry
        + POSE
        + struct.pack("<3d", *increment)
        + END
        + struct.pack("<I6fI6f", 0, *GAUSSIAN, 300, *SAMPLED)
        + struct.pack("<?2f?2iQ", False, 0.0, 0.0, False, 0, 0, 0)
    )
    one = struct.pack("<I", 1) + _named("mrpt::obs::CActionRobotMovement2D", 6, movement)
    return _named("mrpt::obs::CActionCollection", 0, one)


def _frame(observation: bytes) -> bytes:
    return _named("mrpt::obs::CSensoryFrame", 2, struct.pack("<I", 1) + observation)
