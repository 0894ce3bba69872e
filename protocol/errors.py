"""The base of all errors that a user may see: one clear line that says what to do."""


class EarshotError(Exception):
    """An error with a message for people; the command line prints it and exits with 2."""


class MalformedMessageError(EarshotError):
    """A message from the wire that is not what its topic promises; counted and dropped.

    `kind` is the word under which it is counted: encoding, version, size, msgpack, schema, and
    of published ones sequence, replay, and misfit, for what another receiver might understand.
    """

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(f"malformed message ({kind}): {detail}")
        self.kind = kind
