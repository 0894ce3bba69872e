"""Logs read from their beginning, as studies and reports do."""

from collections.abc import Iterable, Iterator

from robot.team.entries import Known, decode_entry
from robot.team.journal import EntryName, LogName
from robot.team.log_context import LogContext


def read_in_order(named: Iterable[tuple[EntryName, bytes]]) -> Iterator[tuple[EntryName, Known]]:
    """The entries in bodies, of any logs, those of each log in order and without a gap.

    Raises MalformedMessageError on the first that is none.
    """
    contexts: dict[LogName, LogContext] = {}
    for name, body in named:
        context = contexts.setdefault(name.log, LogContext())
        entry = decode_entry(body, name.sequence, context)
        context.take(entry)
        yield name, entry
