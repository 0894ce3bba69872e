"""The world's end of the wire: what waits for a robot that does not answer."""

from protocol.allowance import Allowance
from protocol.messages import HeardFrame, Sense
from world.robot_link import MOST_WAITING_BYTES, RobotLink

FRAME = HeardFrame(sender="r1", sent_tick=0, to="*", kind="test", payload=bytes(1_000))


def test_frames_wait_for_a_robot_up_to_a_bound_and_reach_it_in_their_order() -> None:
    link = RobotLink("r2", Allowance(8))
    kept = 0
    for _ in range(10_000):
        if link.is_full:
            break
        link.hold([FRAME.model_copy(update={"sent_tick": kept})])
        kept += 1
    assert MOST_WAITING_BYTES <= kept * FRAME.size_bytes < MOST_WAITING_BYTES + FRAME.size_bytes
    empty = Sense(tick=9, stamp=0.9, encoders=(0, 0), ranges=None, frame_count=0)
    frames, sense = link.outgoing(empty)
    assert [frame.sent_tick for frame in frames] == list(range(kept))
    assert sense.frame_count == kept
    assert link.outgoing(empty) == ([], empty)
    link.hold([FRAME])
    assert not link.is_full
