"""The gate models: nothing beyond d, walls and shadowing as their equations say."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from maps.grid import OccupancyGrid
from protocol.messages import Action, RadioFrame
from protocol.pose import FloatArray
from world.channel import Channel
from world.channel_kernels import fade_all
from world.ledger import Verdict
from world.noise import Noise
from world.radio import Radio
from world.scenario import GateConfig, RobotSpec, Scenario
from world.simulation import Simulation
from world.terrain import Terrain

CELL_M = 0.1
MODELS = ("disc", "line-of-sight", "shadowing")


def hall(wall_m: float = 0.0) -> Terrain:
    """40 × 40 m without anything, or with one wall that begins at x = 20 m."""
    cells = np.zeros((400, 400), dtype=np.int8)
    cells[:, 200 : 200 + round(wall_m / CELL_M)] = 100
    return Terrain(OccupancyGrid(cells, CELL_M, 0.0, 0.0))


def channel(terrain: Terrain, seed: int = 0, **config: object) -> Channel:
    return Channel(GateConfig.model_validate(config), terrain, Noise(seed))


def pair(x: float, to_x: float, y: float = 10.05) -> FloatArray:
    return np.array([[x, y, 0.0], [to_x, y, 0.0]])


def passes(air: Channel, poses: FloatArray) -> bool:
    return not air.faded(poses)[0, 1]


def test_in_free_space_walls_take_nothing_up_to_exactly_the_range() -> None:
    air = channel(hall(), model="line-of-sight", range_m=10.0)
    assert passes(air, pair(5.0, 15.0))
    assert passes(air, pair(5.0, 5.0))


@pytest.mark.parametrize(("exponent", "wall_m"), [(3.0, 0.2), (2.0, 0.2), (3.0, 0.4)])
def test_a_wall_shortens_the_range_by_its_decibels(exponent: float, wall_m: float) -> None:
    air = channel(
        hall(wall_m), model="line-of-sight", path_loss_exponent=exponent, wall_loss_db_per_m=30.0
    )
    reach = 10.0 * 10.0 ** (-30.0 * wall_m / (10.0 * exponent))
    assert passes(air, pair(20.0 - 0.5 * reach, 20.0 + 0.499 * reach))
    assert not passes(air, pair(20.0 - 0.5 * reach, 20.0 + 0.501 * reach))


def test_a_wall_crossed_at_an_angle_takes_more() -> None:
    air = channel(hall(0.2), model="line-of-sight", wall_loss_db_per_m=30.0)
    reach = 10.0 * 10.0 ** (-30.0 * 0.2 * math.sqrt(2.0) / 30.0)
    half = 0.5 * reach / math.sqrt(2.0)
    for scale, heard in ((0.99, True), (1.01, False)):
        ends = [[20.1 - scale * half, 10.0 - scale * half], [20.1 + scale * half] * 2]
        ends[1][1] = 10.0 + scale * half
        assert passes(air, np.array(ends)) is heard


def test_a_wall_without_loss_is_none() -> None:
    air = channel(hall(0.4), model="line-of-sight", wall_loss_db_per_m=0.0)
    assert passes(air, pair(15.1, 25.0))


def test_outside_the_map_all_is_solid() -> None:
    air = channel(hall(), model="line-of-sight", wall_loss_db_per_m=1000.0)
    assert not passes(air, pair(-4.0, 2.0))


def test_shadowing_has_the_deviation_and_the_correlation_it_should() -> None:
    # A link fades where its shadowing exceeds the budget: at a budget of one deviation, Φ(−1).
    sigma, reach = 6.0, 10.0
    apart = reach * 10.0 ** (-sigma / 30.0)
    rng = np.random.default_rng(3)
    here, near = [], []
    for seed in range(150):
        air = channel(hall(), seed, model="shadowing", shadowing_sigma_db=sigma)
        for _ in range(20):
            x, y = rng.uniform(5.0, 25.0, 2)
            here.append(not passes(air, pair(x, x + apart, y)))
            near.append(not passes(air, pair(x, x + apart, y + 0.03)))
    assert np.mean(here) == pytest.approx(0.1587, abs=0.03)
    assert np.mean(np.array(here) == np.array(near)) > 0.95


def test_shadowing_decorrelates_over_its_length() -> None:
    # The sign of the shadowing at two places agrees with probability 1/2 + asin(ρ) / π.
    length, moved, apart = 3.0, 2.0, 9.9999
    agreed = []
    rng = np.random.default_rng(5)
    for seed in range(400):
        air = channel(hall(), seed, model="shadowing", shadowing_length_m=length)
        for _ in range(5):
            x, y = rng.uniform(5.0, 20.0, 2)
            first = np.array([[x, y], [x + apart, y]])
            second = np.array([[x, y], [x + apart, y]])
            turn = math.asin(0.5 * moved / apart) * 2.0  # one end moves, at the same range
            second[1] = x + apart * math.cos(turn), y + apart * math.sin(turn)
            agreed.append(passes(air, first) == passes(air, second))
    expected = 0.5 + math.asin(math.exp(-moved / length)) / math.pi
    assert np.mean(agreed) == pytest.approx(expected, abs=0.06)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    model=st.sampled_from(MODELS),
    range_m=st.sampled_from([0.0, 3.0, 12.0]),
    sigma=st.sampled_from([0.0, 4.0, 30.0]),
)
def test_links_are_symmetric_within_range_and_what_is_delivered(
    seed: int, model: str, range_m: float, sigma: float
) -> None:
    rng = np.random.default_rng(seed)
    config = GateConfig.model_validate(
        {"model": model, "range_m": range_m, "shadowing_sigma_db": sigma}
    )
    names = [f"r{i}" for i in range(6)]
    noise = Noise(seed)
    terrain = hall(0.3)
    radio = Radio(config, names, Channel(config, terrain, noise))
    present = rng.random(6) > 0.1
    poses = np.column_stack([rng.uniform(12.0, 28.0, (6, 2)), np.zeros(6)])
    links = radio.links(poses, present)
    apart = np.hypot(*(poses[:, None, :2] - poses[None, :, :2]).transpose(2, 0, 1))
    assert np.array_equal(links, links.T)
    assert not links[apart > range_m].any()
    frame = RadioFrame(kind="k", payload=b"x")
    sent = {name: [frame] for name, alive in zip(names, present, strict=True) if alive}
    radio.send(sent, 0, poses, present, noise)
    radio.receive(1, present)
    radio.ledger.check()
    delivered = radio.ledger.ended[..., Verdict.DELIVERED, 0] > 0
    assert np.array_equal(delivered, links)
    faded = radio.ledger.ended[..., Verdict.FADE, 0] > 0
    assert not (faded & (apart > range_m)).any()
    assert model != "disc" or not faded.any()
    history = radio.links(np.stack([poses] * 3), np.stack([present] * 3))
    assert np.array_equal(history, np.stack([links] * 3))


def test_what_fades_is_in_the_tables_of_a_gate_that_fades_alone() -> None:
    disc, walls = GateConfig(), GateConfig(model="line-of-sight")
    assert "fade" not in Radio(disc, ["r1"]).ledger.to_dict()["total"]["dropped"]
    air = Channel(walls, hall(), Noise(0))
    assert "fade" in Radio(walls, ["r1"], air).ledger.to_dict()["total"]["dropped"]
    with pytest.raises(ValueError, match="needs a channel"):
        Radio(walls, ["r1"])


@pytest.mark.parametrize(
    "wrong",
    [
        {"model": "cone"},
        {"path_loss_exponent": 0.0},
        {"wall_loss_db_per_m": -1.0},
        {"shadowing_sigma_db": math.nan},
        {"shadowing_length_m": 0.0},
        {"wall_db": 6.0},
    ],
)
def test_a_gate_that_is_none_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        GateConfig.model_validate(wrong)


@pytest.mark.parametrize("model", MODELS)
def test_a_run_goes_on_from_a_checkpoint_with_the_same_links(model: str) -> None:
    scenario = Scenario(
        map="rooms-small",
        seed=5,
        robots=tuple(RobotSpec(name=f"r{i}") for i in range(4)),
        radio=GateConfig.model_validate({"model": model, "range_m": 4.0}),
    )

    def play(simulation: Simulation, ticks: int) -> str:
        for _ in range(ticks):
            actions = {
                name: Action(
                    tick=simulation.tick,
                    frames=(RadioFrame(kind="k", payload=b"x"),),
                    frame_count=1,
                )
                for name in simulation.names
            }
            simulation.step(actions)
        return repr(simulation.ledger.to_dict()) + repr(simulation.link_history.tolist())

    first, second = Simulation(scenario), Simulation(scenario)
    first.step({})
    play(first, 5)
    second.restore(first.state())
    assert play(first, 5) == play(second, 5)


def test_the_kernel_takes_many_ticks_at_once() -> None:
    terrain = hall(0.3)
    points = np.random.default_rng(1).uniform(100.0, 300.0, (7, 5, 2))
    budget, waves = np.array([100.0, 3.0, 4.0, 0.0, 30.0]), np.zeros((0, 5))
    together = np.zeros((7, 5, 5), dtype=bool)
    fade_all(terrain.solid, points, budget, waves, together)
    for one, at in zip(together, points, strict=True):
        alone = np.zeros((1, 5, 5), dtype=bool)
        fade_all(terrain.solid, at[None].copy(), budget, waves, alone)
        assert np.array_equal(one, alone[0])
    assert together.any()
