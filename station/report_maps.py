"""The maps of a run to keep: what each robot has mapped, and what robots that share a frame have
together, in the file that `earshot slam --map` takes."""

from pathlib import Path

from maps.pixels import write_whole
from robot.slam.saved_map import SavedMap, SavedMapError
from station.observer import RobotOutcome, RunOutcome
from station.report_folder import SAVED_MAP, saved_map_of
from world.accuracy import by_frame


def write_saved_maps(outcome: RunOutcome, folder: Path) -> None:
    """Write `map.earshot` of the group that most robots share a frame in, `map-ROBOT.earshot` of
    every other group by its first robot, and `ROBOT/map.earshot` of every robot that mapped."""
    maps = {
        name: found
        for name, robot in sorted(outcome.robots.items())
        if (found := _saved(robot)) is not None
    }
    for name, found in maps.items():
        write_whole(folder / name / SAVED_MAP, found.encode())
    ways = {name: outcome.robots[name].trajectory for name in maps}
    frames = by_frame({name: way.frame if way else name for name, way in ways.items()})
    for rank, group in enumerate(sorted(frames.values(), key=len, reverse=True)):
        file = saved_map_of(group[0]) if rank else SAVED_MAP
        write_whole(folder / file, SavedMap.joined([maps[name] for name in group]).encode())


def _saved(robot: RobotOutcome) -> SavedMap | None:
    """What a robot answered as its map; None where that is nothing, or is no map."""
    if robot.map is None or not robot.map.saved:
        return None
    try:
        return SavedMap.decode(robot.map.saved)
    except SavedMapError:
        return None
