"""The world as one pure object: actions in, senses out, tick by tick.

    simulation = Simulation(scenario)
    senses = simulation.step({})                        # of tick 0
    while not simulation.done:
        senses = simulation.step({name: ... for name in senses})

No clock, no socket, no global random numbers: the same scenario and the same actions give the
same senses to the last bit.
"""

from collections.abc import Mapping

import numpy as np

from maps.grid import BoolArray, OccupancyGrid
from maps.library import load_map
from protocol.config import PoseModel, RadioConfig, RobotConfig
from protocol.messages import STOP, Action, DriveCommand, RadioFrame, Sense
from protocol.pose import FloatArray, Pose2
from protocol.state import adopt_state, dump_state
from world.channel import Channel
from world.drive import Drives
from world.history import History
from world.ledger import Ledger
from world.lidar import Lidars
from world.noise import Noise
from world.radio import Radio
from world.scenario import Scenario
from world.sightings import Sighters
from world.starts import place_robots
from world.terrain import Terrain

ALL_FINISHED = "all robots finished"
TIME_LIMIT = "time limit"
NOBODY_LEFT = "no robot left"

LINK_TICKS = 256


class Simulation:
    """The world of one run. Arrays over robots are in the order of `names`."""

    TRANSIENT = ("scenario", "terrain", "channel")

    def __init__(self, scenario: Scenario, grid: OccupancyGrid | None = None) -> None:
        """Load the scenario's map, or take `grid` in its place.

        Raises MapFileError for a bad map and StartError where the robots cannot be placed.
        """
        self.scenario = scenario
        self.terrain = Terrain(load_map(scenario.map) if grid is None else grid)
        self.names = scenario.names
        self.tick = -1
        self.exit_reason: str | None = None
        self._closed = False  # the last actions are in
        self._noise = Noise(scenario.seed)
        self._starts = place_robots(scenario, self.terrain, self._noise)
        radius = scenario.body.radius_m
        self._drives = Drives(self.terrain, scenario.body, self.names, self._starts)
        self._lidars = Lidars(scenario.lidar, self.names, radius)
        self._sighters = Sighters(scenario.sightings, self.names, radius)
        self.channel = Channel(scenario.radio, self.terrain, self._noise)
        self._radio = Radio(scenario.radio, self.names, self.channel)
        self._commands = dict.fromkeys(self.names, STOP)
        self._command_ticks = dict.fromkeys(self.names, 0)
        self._finished: dict[str, bool] = dict.fromkeys(self.names, False)
        self._present = np.ones(len(self.names), dtype=bool)
        self._listening = np.ones(len(self.names), dtype=bool)
        self.history = History(len(self.names))

    # -- what there is to see

    @property
    def stamp(self) -> float:
        """Simulated time in seconds."""
        return self.tick * self.scenario.tick_s

    @property
    def poses(self) -> FloatArray:
        """True poses, n×3 (m, m, rad), in the world frame."""
        return self._drives.poses

    @property
    def starts(self) -> FloatArray:
        """Where the robots started, n×3."""
        return self._starts

    @property
    def collisions(self) -> dict[str, int]:
        """How often each robot ran into something so far."""
        return dict(zip(self.names, self._drives.collisions.tolist(), strict=True))

    @property
    def links(self) -> BoolArray:
        """Who is within earshot of whom now, n×n."""
        return self._radio.links(self.poses, self._present)

    @property
    def link_history(self) -> BoolArray:
        """Who was within earshot of whom at each tick so far, T×n×n."""
        history = self.history
        links = np.empty((len(history), len(self.names), len(self.names)), dtype=bool)
        # In pieces: distances of all pairs at all ticks of an hour would take half a gigabyte.
        for first in range(0, len(history), LINK_TICKS):
            piece = slice(first, first + LINK_TICKS)
            links[piece] = self._radio.links(history.poses[piece], history.present[piece])
        return links

    @property
    def ledger(self) -> Ledger:
        """What became of every radio frame so far."""
        return self._radio.ledger

    @property
    def finished(self) -> tuple[str, ...]:
        """The robots whose latest action said so, sorted."""
        return tuple(sorted(name for name, finished in self._finished.items() if finished))

    @property
    def alive(self) -> tuple[str, ...]:
        """The robots that were not marked dead."""
        return tuple(n for n, present in zip(self.names, self._present, strict=True) if present)

    @property
    def done(self) -> bool:
        """Whether the run is over; `exit_reason` says why."""
        return self.exit_reason is not None

    def robot_config(self, name: str) -> RobotConfig:
        """What the world tells a robot about itself."""
        scenario, number = self.scenario, self.names.index(name)
        spec = scenario.robots[number]
        start = Pose2.from_array(self._starts[number])
        if scenario.starts == "same":
            start = Pose2.from_array(self._starts[0]).inverse() @ start
        told = scenario.starts != "unknown"
        return RobotConfig(
            name=name,
            team=self.names,
            seed=scenario.seed,
            tick_s=scenario.tick_s,
            start=PoseModel.of(start) if told else None,
            body=scenario.body,
            lidar=scenario.lidar,
            sightings=scenario.sightings,
            radio=RadioConfig(
                range_m=scenario.radio.range_m, bytes_per_tick=scenario.radio.bytes_per_tick
            ),
            engine=spec.engine,
            policy=spec.policy,
        )

    # -- the step

    def step(self, actions: Mapping[str, Action]) -> dict[str, Sense]:
        """The senses of the next tick, for every robot.

        The first call takes no actions and gives tick 0. Later ones take actions that answer the
        present tick, or an earlier one: a late drive command counts from the tick that it
        answers. A robot without an action goes on as last told until its command is `dead_man_s`
        old. When the run is `done`, by these actions or by `end` before, they are still booked,
        but nothing moves any more and there are no senses: all that was heard has been answered.
        """
        if self._closed:
            return {}
        if self.tick < 0:
            if actions:
                raise ValueError("there is nothing to answer before tick 0")
        else:
            self._take(actions)
            if self._is_over():
                return {}
            self._move()
        self.tick += 1
        self._remember()
        return self._sense()

    def end(self, reason: str) -> None:
        """End the run for a reason of the shell's own, such as an interruption."""
        if self.exit_reason is None:
            self.exit_reason = reason
        self._closed = self._closed or self.tick < 0

    def mark_dead(self, name: str) -> None:
        """Await nothing more from a robot: its wheels stop and it hears no frames."""
        self._present[self.names.index(name)] = False
        self._commands[name] = STOP

    def set_listening(self, name: str, listens: bool) -> None:
        """Whether a robot's radio takes in frames; those it does not are booked as absent."""
        self._listening[self.names.index(name)] = listens

    def mark_alive(self, name: str) -> None:
        """A robot that was marked dead is back; it stands where it stopped."""
        number = self.names.index(name)
        self._present[number] = True
        self._finished[name] = False

    def halt(self, name: str) -> None:
        """Stop a robot's wheels until its next action, as for one that missed its deadline."""
        self._commands[name] = STOP

    def _take(self, actions: Mapping[str, Action]) -> None:
        """What the robots want, and what they send."""
        strangers = sorted(set(actions) - set(self.names))
        if strangers:
            raise ValueError(f"no such robots in this scenario: {', '.join(strangers)}")
        frames: dict[str, tuple[RadioFrame, ...]] = {}
        for name in self.alive:
            action = actions.get(name)
            if action is None:
                continue
            frames[name] = action.frames
            answered = min(action.tick, self.tick)
            if answered >= self._command_ticks[name]:
                self._commands[name] = action.drive
                self._command_ticks[name] = answered
                self._finished[name] = action.finished
        hearing = self._present & self._listening
        self._radio.send(frames, self.tick, self.poses, hearing, self._noise)

    def _is_over(self) -> bool:
        """Whether the run ends with the actions of this tick."""
        alive = self.alive
        if not alive:
            self.end(NOBODY_LEFT)
        elif all(self._finished[name] for name in alive):
            self.end(ALL_FINISHED)
        elif self.stamp >= self.scenario.max_sim_s:
            self.end(TIME_LIMIT)
        self._closed = self.done
        return self._closed

    def _move(self) -> None:
        commands = [self._present_command(name) for name in self.names]
        wanted = np.array([[command.forward_mps, command.turn_rps] for command in commands])
        self._drives.step(wanted, self.tick, self.scenario.tick_s, self._noise)

    def _present_command(self, name: str) -> DriveCommand:
        age_s = (self.tick - self._command_ticks[name]) * self.scenario.tick_s
        return self._commands[name] if age_s < self.scenario.pace.dead_man_s else STOP

    def _remember(self) -> None:
        self.history.append(
            self.poses, self._drives.velocities, self._drives.collisions, self._present
        )

    def _sense(self) -> dict[str, Sense]:
        scans = None
        if self._lidars.due(self.tick):
            scans = self._lidars.scan(self.terrain, self.poses, self.tick, self._noise)
        sightings = self._sighters.sight(self.terrain, self.poses, self.tick, self._noise)
        inboxes = self._radio.receive(self.tick, self._present & self._listening)
        encoders = self._drives.encoders.tolist()
        # Made of known good parts; validation would cost more than the ray casting.
        return {
            name: Sense.model_construct(
                tick=self.tick,
                stamp=self.stamp,
                encoders=tuple(encoders[i]),
                ranges=None if scans is None else scans[i],
                sightings=sightings[i],
                frame_count=len(inboxes[i]),
                frames=inboxes[i],
            )
            for i, name in enumerate(self.names)
        }

    # -- checkpoints

    def state(self) -> bytes:
        """A checkpoint from which `restore` carries on as if nothing had happened."""
        return dump_state(self)

    def restore(self, checkpoint: bytes) -> None:
        """Take over the state of a simulation of the same scenario. Raises StateError."""
        adopt_state(self, checkpoint)
        self._drives.terrain = self.terrain
        self._radio.channel = self.channel
