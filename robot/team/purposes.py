"""What the bytes on the radio are for.

The gate counts frames and knows nothing of what is in them. Robots do: they book each frame that
they send or hear by purpose, so that the sum is what the world counts, to the byte.

    keyframes, anchors, closures, links, hello    entries of journals, by what they are
    live      where a robot is, goes, and whom it sees
    vectors   what it holds and whom it hears: the talk that gossip needs
    frames    headers, and what holds entries together
    other     parts of long entries, and what nobody can read
"""

from collections.abc import Iterator

import msgpack

from protocol.errors import MalformedMessageError
from protocol.messages import HeardFrame, RadioFrame
from robot.team.beacon import BEACON
from robot.team.entries import ANCHOR, CLOSURE, HELLO, LINK
from robot.team.keyframes import ALONE, FOLLOWER
from robot.team.parcels import ENTRIES, unpack_entries

LIVE, VECTORS, FRAMES = "live", "vectors", "frames"
ENTRY_PURPOSES = {
    HELLO: "hello",
    ANCHOR: "anchors",
    ALONE: "keyframes",
    FOLLOWER: "keyframes",
    CLOSURE: "closures",
    LINK: "links",
}
OTHER = "other"

Usage = dict[str, int]
"""Bytes by purpose."""


def book(usage: Usage, frame: RadioFrame | HeardFrame) -> None:
    """Add a frame: all of its bytes, each for one purpose."""
    left = frame.size_bytes
    for purpose, size in _parts(frame):
        usage[purpose] = usage.get(purpose, 0) + size
        left -= size
    rest = LIVE if frame.kind == BEACON else FRAMES
    usage[rest] = usage.get(rest, 0) + left


def _parts(frame: RadioFrame | HeardFrame) -> Iterator[tuple[str, int]]:
    """What can be told apart in a frame."""
    if frame.kind == BEACON:
        yield from _talk(frame.payload)
    elif frame.kind == ENTRIES:
        yield from _bodies(frame.payload)
    else:  # part of a long entry, or of nobody's making
        yield OTHER, len(frame.payload)


def _bodies(payload: bytes) -> Iterator[tuple[str, int]]:
    try:
        entries = unpack_entries(payload)
    except MalformedMessageError:
        yield OTHER, len(payload)
        return
    for _, body in entries:
        # An entry is a short list, whose first item is a small number: a byte each.
        yield ENTRY_PURPOSES.get(body[1] if len(body) > 1 else -1, OTHER), len(body)


def _talk(payload: bytes) -> Iterator[tuple[str, int]]:
    try:
        hears, counts, lives = msgpack.unpackb(payload, raw=False)[5:8]
    except Exception:  # msgpack raises many types, all of which mean the same here
        yield OTHER, len(payload)
        return
    yield VECTORS, sum(len(msgpack.packb(field)) for field in (hears, counts, lives))
