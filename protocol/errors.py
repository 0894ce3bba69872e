"""The base of all errors that a user may see: one clear line that says what to do."""

from typing import Any


class EarshotError(Exception):
    """An error with a message for people; the command line prints it and exits with 2.

    It crosses process borders as it is, whatever its class was made from: unpickling would call the
    class with the message alone, and a worker's error that cannot be unpickled breaks its pool.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        return _revive, (type(self), self.args, self.__dict__)


def _revive(
    kind: type[EarshotError], arguments: tuple[Any, ...], said: dict[str, Any]
) -> EarshotError:
    error = kind.__new__(kind)
    error.args = arguments
    error.__dict__.update(said)
    return error


class MalformedMessageError(EarshotError):
    """A message from the wire that is not what its topic promises; counted and dropped.

    `kind` is the word under which it is counted: encoding, version, size, msgpack, schema, and
    of published ones sequence, replay, and misfit, for what another receiver might understand.
    """

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(f"malformed message ({kind}): {detail}")
        self.kind = kind
