"""How numbers of a run are put into words, the same on the screen, in tables and in pictures."""

from pathlib import Path

from world.scenario import Scenario

NOTHING = "–"


def describe(scenario: Scenario) -> str:
    """A run in one line."""
    count = len(scenario.robots)
    return (
        f"{Path(scenario.map).stem} · {count} robot{'' if count == 1 else 's'} · "
        f"radio {scenario.radio.range_m:g} m · seed {scenario.seed}"
    )


def clock_time(seconds: float | None) -> str:
    """Seconds as m:ss."""
    if seconds is None:
        return NOTHING
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def percent(share: float | None) -> str:
    return NOTHING if share is None else f"{100.0 * share:.1f} %"


def centimetres(metres: float | None) -> str:
    return NOTHING if metres is None else f"{100.0 * metres:.1f} cm"


def times(factor: float | None) -> str:
    return NOTHING if factor is None else f"{factor:.1f}×"


def readable_bytes(amount: int) -> str:
    """A number of bytes with three digits and a unit of powers of 1000."""
    for unit, size in (("MB", 1_000_000), ("kB", 1_000)):
        if amount >= size:
            return f"{amount / size:.3g} {unit}"
    return f"{amount} B"
