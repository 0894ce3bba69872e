import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.codec import MAX_MESSAGE_BYTES, decode, encode, encoding_of
from protocol.errors import MalformedMessageError
from protocol.messages import Action, DriveCommand, HeardFrame, MapReply, RadioFrame, Sense
from protocol.model import Message

SCHEMAS: tuple[type[Message], ...] = (Action, HeardFrame, MapReply, RadioFrame, Sense)
PLAIN = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63)
    | st.floats()
    | st.text()
    | st.binary(max_size=64),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)
NAMES = st.from_regex(r"[a-z][a-z0-9_-]{0,31}", fullmatch=True)


@given(st.sampled_from(SCHEMAS), st.binary(max_size=400))
def test_any_bytes_decode_or_are_malformed(schema: type[Message], payload: bytes) -> None:
    _decode_or_refuse(schema, payload)


@given(st.sampled_from(SCHEMAS), PLAIN)
def test_any_msgpack_decodes_or_is_malformed(schema: type[Message], fields: object) -> None:
    _decode_or_refuse(schema, msgpack.packb(fields))


@given(
    st.sampled_from(sorted(Sense.model_fields)), PLAIN, st.binary(max_size=40), st.integers(0, 200)
)
def test_a_damaged_sense_decodes_or_is_malformed(
    name: str, value: object, noise: bytes, place: int
) -> None:
    sense = Sense(tick=4, stamp=0.4, encoders=(7, -9), ranges=[1.5, 2.5])
    fields = {**sense.model_dump(), name: value}
    _decode_or_refuse(Sense, msgpack.packb(fields))
    payload = encode(sense)
    _decode_or_refuse(Sense, payload[:place])
    _decode_or_refuse(Sense, payload[:place] + noise + payload[place:])


@given(
    st.integers(0, 2**53),
    st.floats(allow_nan=False, allow_infinity=False),
    st.floats(allow_nan=False, allow_infinity=False),
    st.booleans(),
)
def test_actions_come_back_as_they_went(
    tick: int, forward: float, turn: float, finished: bool
) -> None:
    drive = DriveCommand(forward_mps=forward, turn_rps=turn)
    action = Action(tick=tick, drive=drive, finished=finished)
    assert decode(Action, encode(action), encoding_of(Action)) == action


@given(NAMES, st.binary(max_size=1400))
def test_frames_come_back_as_they_went(name: str, payload: bytes) -> None:
    frame = RadioFrame(to=name, kind="entries", payload=payload)
    assert decode(RadioFrame, encode(frame), encoding_of(RadioFrame)) == frame


def test_defects_are_told_apart() -> None:
    payload = encode(Action(tick=1))
    cases = {
        "version": (payload, "application/msgpack;earshot/action/2"),
        "encoding": (payload, encoding_of(Sense)),
        "size": (b"\x00" * (MAX_MESSAGE_BYTES + 1), encoding_of(Action)),
        "msgpack": (b"\x81", encoding_of(Action)),
        "schema": (msgpack.packb({"tick": -1}), encoding_of(Action)),
    }
    for kind, (data, encoding) in cases.items():
        with pytest.raises(MalformedMessageError) as caught:
            decode(Action, data, encoding)
        assert caught.value.kind == kind


def test_unknown_fields_and_numbers_that_are_none_are_refused() -> None:
    for fields in (
        {"tick": 1, "surprise": 1},
        {"tick": 1, "drive": {"forward_mps": float("nan")}},
        {"tick": 1, "drive": {"forward_mps": float("inf")}},
    ):
        with pytest.raises(MalformedMessageError):
            decode(Action, msgpack.packb(fields))


def _decode_or_refuse(schema: type[Message], payload: bytes) -> None:
    try:
        assert isinstance(decode(schema, payload), schema)
    except MalformedMessageError as error:
        assert error.kind in {"size", "msgpack", "schema"}
