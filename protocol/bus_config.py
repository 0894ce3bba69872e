"""Where the bus is opened: four ways, always with explicit endpoints, never by discovery.

Discovery over multicast is slow, does not cross container bridges, and lets two teams on one
network talk to each other; it stays off in every way.
"""

import json
from pathlib import Path
from typing import Literal

import zenoh
from pydantic import Field

from protocol.access import access_control
from protocol.config import RobotName
from protocol.errors import EarshotError
from protocol.keys import read_key, users_file
from protocol.model import Model


class BusConfigError(EarshotError):
    """A Zenoh option or file that cannot be used."""


class BusConfig(Model):
    """How to open a session. `overrides` are `KEY:VALUE` pairs of Zenoh's own configuration."""

    mode: Literal["memory", "peer", "router", "client"] = "client"
    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    namespace: str = Field("earshot", pattern=r"^[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*$")
    connect_timeout_s: float = Field(30.0, ge=0.0, description="how long to try to connect")
    lease_s: float = Field(
        10.0, gt=0.0, description="silence of a link after which its other end counts as gone"
    )
    key: Path | None = Field(None, description="a client's own key file (protocol.keys)")
    keys: Path | None = Field(
        None, description="a router's folder of keys: with one, `members` alone may take part"
    )
    members: tuple[RobotName, ...] = ()
    file: Path | None = Field(None, description="a json5 file of Zenoh to start from")
    overrides: tuple[str, ...] = ()

    @staticmethod
    def memory() -> "BusConfig":
        """One session that talks to itself: no links, one process."""
        return BusConfig(mode="memory")

    @staticmethod
    def loopback(port: int, *, listen: bool, namespace: str = "earshot") -> "BusConfig":
        """A peer on 127.0.0.1 that listens at a port or connects to it."""
        endpoints = (loopback_endpoint(port),)
        return BusConfig(
            mode="peer",
            listen=endpoints if listen else (),
            connect=() if listen else endpoints,
            namespace=namespace,
        )

    @staticmethod
    def router(*listen: str, namespace: str = "earshot") -> "BusConfig":
        """An embedded router: what the world opens. Anybody may take part until it is `walled`."""
        return BusConfig(mode="router", listen=listen, namespace=namespace)

    @staticmethod
    def client(*connect: str, namespace: str = "earshot", key: Path | None = None) -> "BusConfig":
        """A client of a router: what a robot opens, with its key where the router is walled."""
        return BusConfig(mode="client", connect=connect, namespace=namespace, key=key)

    def walled(self, keys: Path, members: tuple[str, ...]) -> "BusConfig":
        """The same with access control: each of these robots under its own keys alone."""
        return self.model_copy(update={"keys": keys, "members": members})

    def summary(self) -> str:
        """One phrase for messages: the mode and its endpoints."""
        parts: list[str] = [self.mode]
        if self.listen:
            parts.append("listening on " + ", ".join(self.listen))
        if self.connect:
            parts.append("connecting to " + ", ".join(self.connect))
        return " ".join(parts)

    def refusal_hint(self) -> str:
        """What to add where a connection failed: a walled router refuses without a word."""
        if self.mode != "client":
            return ""
        if self.key is None:
            return " (does the world ask for keys? Then give this robot's own with --keys)"
        return f" (is {self.key} one of the keys that the world was given?)"

    def to_zenoh(self) -> zenoh.Config:
        """The configuration as Zenoh takes it.

        Raises BusConfigError for what it refuses, and KeysError for keys that are not there.
        """
        config = self._base()
        _insert(config, "mode", "peer" if self.mode == "memory" else self.mode)
        _insert(config, "listen/endpoints", list(self.listen))
        _insert(config, "connect/endpoints", list(self.connect))
        _insert(config, "connect/timeout_ms", int(1000 * self.connect_timeout_s))
        _insert(config, "connect/exit_on_failure", True)
        retry = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2}
        _insert(config, "connect/retry", retry)
        _insert(config, "scouting/multicast/enabled", False)
        _insert(config, "scouting/gossip/enabled", False)
        _insert(config, "scouting/delay", 0)  # nobody is scouted: nothing to wait for
        # Each process would keep 16 MB for it, and our messages are too small to gain by it.
        _insert(config, "transport/shared_memory/enabled", False)
        _insert(config, "transport/link/tx/lease", int(1000 * self.lease_s))
        _insert(config, "namespace", self.namespace)
        self._insert_access(config)
        for override in self.overrides:
            key, colon, value = override.partition(":")
            if not colon:
                raise BusConfigError(f'--cfg {override}: expected KEY:VALUE, such as mode:"peer"')
            _insert_json5(config, key, value)
        return config

    def _insert_access(self, config: zenoh.Config) -> None:
        """The router's users and rules, or what a client proves its name with."""
        if self.keys is not None:
            users = users_file(self.keys, self.members)
            _insert(config, "transport/auth/usrpwd/dictionary_file", str(users))
            _insert(config, "access_control", access_control(self.members, self.namespace))
        if self.key is not None:
            key = read_key(self.key)
            _insert(config, "transport/auth/usrpwd/user", key.user)
            _insert(config, "transport/auth/usrpwd/password", key.password)

    def _base(self) -> zenoh.Config:
        if self.file is None:
            return zenoh.Config()
        try:
            return zenoh.Config.from_file(self.file)
        except zenoh.ZError as error:
            raise BusConfigError(f"{self.file}: not a Zenoh configuration: {error}") from error


def loopback_endpoint(port: int) -> str:
    return f"tcp/127.0.0.1:{port}"


def _insert(config: zenoh.Config, key: str, value: object) -> None:
    _insert_json5(config, key, json.dumps(value))


def _insert_json5(config: zenoh.Config, key: str, value: str) -> None:
    try:
        config.insert_json5(key, value)
    except zenoh.ZError as error:
        raise BusConfigError(f"Zenoh refuses {key}: {value}: {error}") from error
