"""One robot: perception, SLAM, mapping, team, exploration, and the brain that composes them."""

import protocol as _protocol  # fixes the process environment before numpy comes in

__all__: list[str] = []
del _protocol
