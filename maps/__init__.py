"""Occupancy grids, their files, the generator, and the maps that ship."""

import protocol as _protocol  # fixes the process environment before numpy comes in

__all__: list[str] = []
del _protocol
