"""How many keyframes show each place from each side, so that no more are kept than are of use."""

import math

from protocol.pose import Pose2
from robot.slam.config import RevisitConfig


class KeptPlaces:
    """Keyframes kept for good, counted by place and heading; a scan that sees all round is one for
    every heading."""

    def __init__(self, sees_all_round: bool) -> None:
        self._sees_all_round = sees_all_round
        self._kept: dict[tuple[int, int, int], int] = {}

    def take(self, pose: Pose2, config: RevisitConfig) -> bool:
        """Whether few keyframes show this place from this side; counts one more if so."""
        side, enough = math.floor(pose.theta / config.place_rad), config.enough_keyframes
        if self._sees_all_round:
            side, enough = 0, math.ceil(enough * config.place_rad / (2.0 * math.pi))
        place = (math.floor(pose.x / config.place_m), math.floor(pose.y / config.place_m), side)
        kept = self._kept.get(place, 0)
        self._kept[place] = max(kept, min(kept + 1, enough))
        return kept < enough

    def forget(self, here: Pose2, config: RevisitConfig) -> None:
        """What was kept of the places around here does not show what is there now."""
        self._kept = {
            place: kept
            for place, kept in self._kept.items()
            if math.hypot(place[0] * config.place_m - here.x, place[1] * config.place_m - here.y)
            > config.near_m
        }
