"""Ground truth: terrain, drives, sensors, the radio gate, the simulation and its referee."""

import protocol as _protocol  # fixes the process environment before numpy comes in

__all__: list[str] = []
del _protocol
