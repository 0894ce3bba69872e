"""The radio gate: what passes, what is dropped and why, and a ledger that accounts for it all."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.messages import HeardFrame, RadioFrame
from protocol.pose import FloatArray
from world.ledger import MAX_KINDS, LedgerError, Verdict
from world.noise import Noise
from world.radio import Radio
from world.scenario import GateConfig

Sent = Mapping[str, Sequence[RadioFrame]]


def frame(to: str = "*", kind: str = "journal", size: int = 10) -> RadioFrame:
    return RadioFrame(to=to, kind=kind, payload=bytes(size))


def line(*positions: float) -> FloatArray:
    return np.array([[x, 0.0, 0.0] for x in positions])


class Air:
    """A radio with its robots, ticked by hand."""

    def __init__(self, poses: FloatArray, seed: int = 0, **config: object) -> None:
        self.names = [f"r{i}" for i in range(len(poses))]
        self.radio = Radio(GateConfig.model_validate(config), self.names)
        self.ledger = self.radio.ledger
        self.poses = poses
        self.present = np.ones(len(poses), dtype=bool)
        self.noise = Noise(seed)
        self.tick = 0

    def step(self, sent: Sent) -> dict[str, tuple[HeardFrame, ...]]:
        self.radio.send(sent, self.tick, self.poses, self.present, self.noise)
        self.tick += 1
        inboxes = self.radio.receive(self.tick, self.present)
        self.ledger.check()
        return dict(zip(self.names, inboxes, strict=True))

    def ended(self, sender: int, receiver: int) -> dict[str, int]:
        counts = self.ledger.ended[sender, receiver, :, 0].tolist()
        return {v.name.lower(): counts[v] for v in Verdict if counts[v]}


def test_a_broadcast_reaches_all_within_range_and_nobody_else() -> None:
    air = Air(line(0.0, 4.0, 9.0), range_m=5.0)
    heard = air.step({"r1": [frame()], "r0": [frame()]})
    assert [f.sender for f in heard["r0"]] == ["r1"]
    assert [f.sender for f in heard["r1"]] == ["r0"]
    assert [f.sender for f in heard["r2"]] == ["r1"]
    assert air.ended(0, 2) == {"range": 1}


def test_a_frame_to_one_is_offered_to_one() -> None:
    air = Air(line(0.0, 1.0, 2.0))
    heard = air.step({"r0": [frame(to="r2", kind="journal")]})
    assert [len(heard[name]) for name in air.names] == [0, 0, 1]
    (received,) = heard["r2"]
    assert (received.sender, received.to, received.sent_tick, received.kind) == (
        "r0",
        "r2",
        0,
        "journal",
    )
    assert received == HeardFrame.model_validate(received.model_dump())
    assert air.ledger.offered[0, :, 0].tolist() == [0, 0, 1]


def test_exactly_at_the_range_is_within_it() -> None:
    air = Air(line(0.0, 5.0, np.nextafter(5.0, 6.0)), range_m=5.0)
    air.step({"r0": [frame()]})
    assert air.ended(0, 1) == {"delivered": 1}
    assert air.ended(0, 2) == {"range": 1}


def test_distance_counts_when_a_frame_is_sent() -> None:
    air = Air(line(0.0, 4.0), range_m=5.0, latency_ticks=3)
    assert air.step({"r0": [frame()]})["r1"] == ()
    air.poses = line(0.0, 400.0)
    assert air.ledger.in_flight[0, 1].tolist() == [1, frame().size_bytes]
    assert air.step({"r0": [frame()]})["r1"] == ()
    assert [f.sent_tick for f in air.step({})["r1"]] == [0]
    assert air.ended(0, 1) == {"delivered": 1, "range": 1}


def test_delivery_is_in_the_order_of_ticks_senders_and_index() -> None:
    air = Air(line(0.0, 1.0, 2.0), latency_ticks=1)
    sent = {name: [frame(kind=f"{name}-{i}") for i in range(3)] for name in ("r2", "r0")}
    heard = air.step(sent)["r1"]
    assert [f.kind for f in heard] == ["r0-0", "r0-1", "r0-2", "r2-0", "r2-1", "r2-2"]


def test_a_link_carries_so_many_bytes_a_tick_and_pair() -> None:
    size = frame(size=100).size_bytes
    air = Air(line(0.0, 1.0, 2.0), bytes_per_tick=3 * size)
    burst = [frame(to="r1", size=100) for _ in range(5)]
    heard = air.step({"r0": burst, "r2": burst[:2]})
    assert len(heard["r1"]) == 5
    assert air.ended(0, 1) == {"delivered": 3, "capacity": 2}
    assert air.ended(2, 1) == {"delivered": 2}
    air.step({"r0": burst[:1]})
    assert air.ended(0, 1) == {"delivered": 4, "capacity": 2}


def test_a_smaller_frame_may_pass_where_a_larger_did_not() -> None:
    room = frame(size=400).size_bytes + frame(size=1).size_bytes
    air = Air(line(0.0, 1.0), bytes_per_tick=room)
    heard = air.step({"r0": [frame(size=400), frame(size=1000), frame(size=1), frame(size=1)]})
    assert [len(f.payload) for f in heard["r1"]] == [400, 1]


def test_loss_is_as_frequent_as_told_and_robots_do_not_share_luck() -> None:
    air = Air(line(0.0, 1.0, 2.0), loss=0.3, bytes_per_tick=10**9, seed=4)
    for _ in range(20):
        air.step({"r0": [frame(size=1)] * 100})
    lost = air.ledger.ended[0, 1:, Verdict.LOSS, 0] / 2000.0
    assert lost == pytest.approx(0.3, abs=5.0 * np.sqrt(0.21 / 2000.0))
    assert lost[0] != lost[1]


def test_a_death_shifts_nobody_s_luck() -> None:
    def delivered(dead: bool) -> list[list[str]]:
        air = Air(line(0.0, 1.0, 2.0), loss=0.5, seed=8)
        air.present[2] = not dead
        sent = {f"r{i}": [frame(kind=f"k{k}") for k in range(20)] for i in range(2)}
        return [[f.kind for f in air.step(sent)["r1"]] for _ in range(3)]

    assert delivered(dead=False) == delivered(dead=True)


def test_the_dead_hear_nothing_and_it_is_booked() -> None:
    air = Air(line(0.0, 1.0), latency_ticks=2)
    air.step({"r0": [frame()]})
    air.present[1] = False
    air.step({"r0": [frame()]})
    assert air.step({})["r1"] == ()
    assert air.ended(0, 1) == {"absent": 2}


@pytest.mark.parametrize("to", ["r0", "r7", "stranger"])
def test_a_frame_to_nobody_is_counted_and_offered_to_no_pair(to: str) -> None:
    air = Air(line(0.0, 1.0))
    air.step({"r0": [frame(to=to)]})
    size = frame().size_bytes
    assert air.ledger.unknown_recipient[0].tolist() == [1, size]
    assert air.ledger.sent[0].tolist() == [1, size]
    assert not air.ledger.offered.any()


def test_a_frame_no_radio_would_carry_is_counted() -> None:
    air = Air(line(0.0, 1.0))
    huge = RadioFrame.model_construct(to="*", kind="x", payload=bytes(10_000))
    assert air.step({"r0": [huge, frame()]})["r1"][0].payload == bytes(10)
    assert air.ledger.malformed[0].tolist() == [1, huge.size_bytes]
    assert air.ledger.sent[0, 0] == 2


def test_kinds_are_counted_apart_until_there_are_too_many() -> None:
    air = Air(line(0.0, 1.0), bytes_per_tick=10**9)
    air.step({"r0": [frame(kind="beacon"), frame(kind="journal"), frame(kind="beacon")]})
    kinds = air.ledger.to_dict()["kinds"]
    assert kinds["beacon"]["delivered"]["frames"] == 2
    assert kinds["journal"]["offered"]["frames"] == 1
    air.step({"r0": [frame(kind=f"k{i}") for i in range(200)]})
    kinds = air.ledger.to_dict()["kinds"]
    assert len(kinds) == MAX_KINDS
    assert sum(kind["delivered"]["frames"] for kind in kinds.values()) == 203
    assert kinds["other"]["delivered"]["frames"] == 203 - 3 - (MAX_KINDS - 3)


def test_an_account_that_is_wrong_is_found() -> None:
    air = Air(line(0.0, 1.0))
    air.step({"r0": [frame()]})
    air.ledger.ended[0, 1, Verdict.LOSS, 0] += 1
    with pytest.raises(LedgerError, match="r0 -> r1"):
        air.ledger.check()


def test_links_are_those_over_which_frames_pass() -> None:
    air = Air(line(0.0, 4.0, 9.0, 5.0), range_m=5.0)
    air.present[3] = False
    links = air.radio.links(air.poses, air.present)
    assert links.astype(int).tolist() == [[0, 1, 0, 0], [1, 0, 1, 0], [0, 1, 0, 0], [0] * 4]
    history = air.radio.links(np.stack([air.poses] * 3), np.stack([air.present] * 3))
    assert np.array_equal(history, np.stack([links] * 3))


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    robots=st.integers(1, 6),
    range_m=st.sampled_from([0.0, 3.0, 10.0]),
    loss=st.sampled_from([0.0, 0.2, 1.0]),
    latency_ticks=st.integers(1, 4),
    bytes_per_tick=st.sampled_from([0, 600, 12_000]),
)
def test_every_offer_is_accounted_for(
    seed: int, robots: int, range_m: float, loss: float, latency_ticks: int, bytes_per_tick: int
) -> None:
    rng = np.random.default_rng(seed)
    air = Air(
        rng.uniform(0.0, 12.0, (robots, 3)),
        seed,
        range_m=range_m,
        loss=loss,
        latency_ticks=latency_ticks,
        bytes_per_tick=bytes_per_tick,
    )
    sent = heard = 0
    for _ in range(8):
        air.poses = air.poses + rng.normal(0.0, 0.5, air.poses.shape)
        air.present = air.present & (rng.random(robots) > 0.05)
        recipients = [*air.names, "*", "*", "*", "nobody"]
        frames = {
            name: [
                frame(
                    recipients[rng.integers(len(recipients))],
                    f"k{rng.integers(3)}",
                    int(rng.integers(1400)),
                )
                for _ in range(rng.integers(4))
            ]
            for name in air.names
        }
        sent += sum(map(len, frames.values()))
        heard += sum(map(len, air.step(frames).values()))
    total = air.ledger.to_dict()["total"]
    dropped = sum(reason["frames"] for reason in total["dropped"].values())
    assert total["delivered"]["frames"] == heard
    assert total["offered"]["frames"] == heard + dropped + total["in_flight"]["frames"]
    assert int(air.ledger.sent[:, 0].sum()) == sent
    assert sum(row["offered"]["frames"] for row in air.ledger.table()) == total["offered"]["frames"]


def test_a_million_random_frames_obey_the_range() -> None:
    """None is delivered beyond d, and none within d is lost without a booked reason."""
    rng = np.random.default_rng(12)
    robots, per_tick, reach = 40, 8, 10.0
    air = Air(np.zeros((robots, 3)), 12, range_m=reach, loss=0.1, bytes_per_tick=3_000)
    offered = 0
    while offered < 1_000_000:
        air.poses = rng.uniform(0.0, 25.0, (robots, 3))
        if rng.random() < 0.5:  # many at exactly d, and a rounding error off it
            air.poses[1:, :2] = air.poses[0, :2] + rng.choice(
                [[reach, 0.0], [6.0, 8.0]], robots - 1
            )
        apart = np.hypot(*(air.poses[:, None, :2] - air.poses[None, :, :2]).transpose(2, 0, 1))
        before = air.ledger.ended[:, :, :, 0].copy()
        sizes = rng.integers(0, 1400, robots)
        heard = air.step(
            {n: [frame(size=int(s))] * per_tick for n, s in zip(air.names, sizes, strict=True)}
        )
        ended = air.ledger.ended[:, :, :, 0] - before
        others = ~np.eye(robots, dtype=bool)
        within = others & (apart <= reach)
        assert not ended[~within][:, Verdict.DELIVERED].any()
        assert (ended[within][:, Verdict.RANGE] == 0).all()
        assert (ended.sum(axis=2)[others] == per_tick).all()
        assert (ended[others & ~within][:, Verdict.RANGE] == per_tick).all()
        received = [len(heard[name]) for name in air.names]
        assert received == ended[:, :, Verdict.DELIVERED].sum(axis=0).tolist()
        offered += robots * (robots - 1) * per_tick
