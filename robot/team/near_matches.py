"""Matches between places that an alignment already puts near each other: what makes it precise.

They are found by climbing from where the alignment says, so they say nothing about whether it is
right, and are told apart from matches that do.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from protocol.pose import Pose2, wrap_angle
from robot.team.entries import Link
from robot.team.evidence import Kind
from robot.team.joint import Solution
from robot.team.journal import LogName
from robot.team.place import Place
from robot.team.place_match import match_from

APART_M = 5.0
# A match farther than this from where the alignment puts it is of another place.
MAX_SHIFT_M, MAX_TURN_RAD = 0.5, 0.1


def near_matches(
    solution: Solution, places: Mapping[LogName, Sequence[Place]], a: LogName, b: LogName
) -> list[Link]:
    """Links of log a to log b between all places that `solution` puts near each other."""
    found = []
    for ours in places[a]:
        T_ours = Pose2.from_array(solution[a][ours.anchor])
        for theirs in places[b]:
            guess = T_ours.inverse() @ Pose2.from_array(solution[b][theirs.anchor])
            apart = guess.apply(theirs.centre[None])[0] - ours.centre
            if np.hypot(*apart) > APART_M:
                continue
            match = match_from(ours, theirs, guess, Kind.NEAR)
            shift = guess.inverse() @ match.T_a_b
            if (
                not match.objection
                and math.hypot(shift.x, shift.y) <= MAX_SHIFT_M
                and abs(wrap_angle(shift.theta)) <= MAX_TURN_RAD
            ):
                found.append(
                    Link(
                        ours.anchor,
                        b,
                        theirs.anchor,
                        match.T_a_b,
                        match.information,
                        match.evidence,
                    )
                )
    return found
