"""The loop inside every run: the world gives senses, each brain answers with an action.

Neither side knows a clock, a socket or a file; whoever moves senses and actions between them, as
this loop does or as Zenoh does between processes, gets the same run to the last bit.
"""

from robot.brain import Brain
from world.referee import Referee
from world.scenario import RobotSpec, Scenario
from world.simulation import Simulation

scenario = Scenario(
    map="rooms-small",
    seed=2,
    robots=(RobotSpec(name="ada"), RobotSpec(name="bob")),
    max_sim_s=120.0,
)
simulation = Simulation(scenario)
brains = {name: Brain(simulation.robot_config(name)) for name in simulation.names}

senses = simulation.step({})  # tick 0: nothing to answer yet
while not simulation.done:
    actions = {}
    for name, brain in brains.items():
        actions[name] = brain.step(senses[name])
        brain.take_records()  # a robot with a disk makes these durable before its frames leave
    senses = simulation.step(actions)
    if simulation.tick % 50 == 0:
        for name, brain in brains.items():
            print(f"{simulation.stamp:5.1f} s  {name}: {brain.report().activity}")

replies = {
    name: (brain.map_reply(exact=True), brain.trajectory_reply()) for name, brain in brains.items()
}
score = Referee(simulation).score(replies)
print(f"{simulation.exit_reason}: covered {score.coverage:.1%}")
for name, robot in score.robots.items():
    print(f"{name} drove {robot.driven_m:.1f} m, error {robot.ate_rmse_m:.3f} m")
