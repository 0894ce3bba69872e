"""The operator's desk: the command line, launching, live picture and reports."""

import protocol as _protocol  # fixes the process environment before numpy comes in

__all__: list[str] = []
del _protocol
