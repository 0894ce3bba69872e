"""Messages to bytes and back: msgpack maps, arrays as raw little-endian bytes.

The schema name and version travel beside the payload (in Zenoh's encoding field), so that a
receiver can refuse what it does not speak before it looks inside.
"""

from typing import Any, TypeVar

import msgpack
from pydantic import ValidationError

from protocol.errors import MalformedMessageError
from protocol.model import Message

M = TypeVar("M", bound=Message)

# A joint map of 200 × 200 m at 5 cm is 16 MB; anything larger than this is not one of ours.
MAX_MESSAGE_BYTES = 64 << 20


def encoding_of(schema: type[Message]) -> str:
    """The encoding string that goes with every message of a schema."""
    return f"application/msgpack;earshot/{schema.SCHEMA}/{schema.VERSION}"


def encode(message: Message) -> bytes:
    """The payload of a message."""
    packed: bytes = msgpack.packb(message.model_dump(), use_bin_type=True)
    return packed


def decode(schema: type[M], payload: bytes, encoding: str | None = None) -> M:
    """The message in a payload.

    Raises MalformedMessageError when the encoding names another schema or version, when the
    payload is oversized or no msgpack, or when a field does not fit the schema.
    """
    if encoding is not None and encoding != encoding_of(schema):
        wrong_version = encoding.rpartition("/")[0] == encoding_of(schema).rpartition("/")[0]
        raise MalformedMessageError(
            "version" if wrong_version else "encoding",
            f"expected {encoding_of(schema)}, got {encoding[:120]!r}",
        )
    if len(payload) > MAX_MESSAGE_BYTES:
        raise MalformedMessageError("size", f"{len(payload)} bytes")
    try:
        fields: Any = msgpack.unpackb(payload, raw=False, strict_map_key=True)
    except Exception as error:  # msgpack raises many types, all of which mean the same here
        raise MalformedMessageError("msgpack", str(error)[:200]) from error
    try:
        return schema.model_validate(fields)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "message"
        raise MalformedMessageError(
            "schema", f"{schema.SCHEMA}: {place}: {first['msg']}"
        ) from error
