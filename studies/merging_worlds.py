"""The worlds that merging is studied in, and what of them tells their places apart.

Thresholds were fixed on `TUNING`; `SCORING` and `REPEATING` are for the figures. Real buildings do
not ship, so their files are named on the command line.
"""

from pathlib import Path

from maps.library import varied
from studies.lone_journals import LoneJournal

# Generated kinds of world that do not repeat themselves.
KINDS = (
    "office:seed={}",
    "institute:seed={}",
    "wings:seed={}",
    "loop:seed={}",
    "rooms-small:seed={}",
    "rooms-small:seed={},width_m=18,height_m=13,things_per_room=3",
)
# These do: each part of the world fits in other places of it.
REPEATING_KINDS = ("rows:seed={}", "symmetric:seed={}")

SETS: dict[str, tuple[str, ...]] = {
    "tuning": tuple(kind.format(seed) for seed in (101, 102, 103) for kind in KINDS),
    "scoring": tuple(kind.format(seed) for seed in (201, 202, 203) for kind in KINDS),
    "tuning-repeating": tuple(kind.format(seed) for seed in (101, 102) for kind in REPEATING_KINDS),
    "repeating": tuple(kind.format(seed) for seed in range(201, 206) for kind in REPEATING_KINDS),
}

# A map of a real building with corridors that look alike.
ALIKE = "aces"
# Overlap from which two robots in a building with look-alikes have seen what tells these apart.
MUCH_OVERLAP = 0.5


def worlds_of(names: str) -> list[str]:
    """The worlds of a set, or the one of that name."""
    return list(SETS.get(names, (names,)))


def kind_of(world: str) -> str:
    """What a world is listed under."""
    return Path(world).stem if world.endswith((".yaml", ".yml")) else world.partition(":")[0]


def repeats(world: str) -> bool:
    """Whether parts of a world fit in other places of it."""
    return kind_of(world) in ("rows", "symmetric", ALIKE)


def is_told_apart(one: LoneJournal, other: LoneJournal, overlap: float) -> bool:
    """Whether what two robots in one world have seen leaves one answer only.

    It always does in a world that does not repeat. In rows of rooms the hall at their end tells; in
    a building that looks the same turned by 180° nothing does.
    """
    kind = kind_of(one.world)
    if not repeats(one.world):
        return True
    if kind == "symmetric":
        return False
    if kind == "rows":
        config = varied(one.world)
        assert config is not None
        end = config.wall_m + config.room_width_m
        return all(bool((journal.truth[:, 0] < end).any()) for journal in (one, other))
    return overlap >= MUCH_OVERLAP
