"""Errors that a worker process hands to the one that asked it."""

import pickle

from protocol.errors import EarshotError, MalformedMessageError


def test_errors_cross_process_borders() -> None:
    for error in (EarshotError("no map here"), MalformedMessageError("size", "3 bytes, not 4")):
        found = pickle.loads(pickle.dumps(error))
        assert (type(found), str(found)) == (type(error), str(error))
        assert vars(found) == vars(error)
