"""A port on 127.0.0.1 that nobody uses at the moment."""

import socket


def free_port() -> int:
    """Free when asked; another program may take it before it is used."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
