"""A team on hosts of their own: each in a network namespace with an address of its own, joined by a
bridge in yet another one. Nothing but packets through the world's router can pass between them."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

import yaml

from protocol.errors import EarshotError
from protocol.keys import key_path, make_keys
from world.scenario import Scenario

ROOT = Path(__file__).resolve().parents[1]
WAIT_S = 300.0
WORLD = "world"
METRICS = "metrics.json"


class NetworkError(EarshotError):
    """Namespaces cannot be made here, or what ran in them failed."""


@contextmanager
def network(hosts: tuple[str, ...]) -> Iterator[dict[str, str]]:
    """Addresses by host. Namespaces go with everything in them. Raises NetworkError."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        raise NetworkError("network namespaces need root and the ip command")
    with ExitStack() as stack:
        try:
            for host in ("switch", *hosts):
                _ip("netns", "add", _namespace(host))
                stack.callback(_ip, "netns", "del", _namespace(host))
            _ip("-n", _namespace("switch"), "link", "add", "bridge", "type", "bridge")
            _ip("-n", _namespace("switch"), "link", "set", "bridge", "up")
            for number, host in enumerate(hosts, start=1):
                _plug_in(number, host)
        except subprocess.CalledProcessError as error:
            reason = error.stderr.strip()
            raise NetworkError(f"network namespaces are not allowed here: {reason}") from None
        yield {host: _address(number) for number, host in enumerate(hosts, start=1)}


def run_on_hosts(
    scenario: Scenario, folder: Path, environment: Mapping[str, str] | None = None
) -> Path:
    """Play a scenario with world and robots on hosts of their own; returns the metrics' file.

    Raises NetworkError, with what they said, unless all end properly.
    """
    hosts = (WORLD, *scenario.names)
    with network(hosts) as addresses:
        commands = _commands(scenario, folder, f"tcp/{addresses[WORLD]}:7447")
        running: dict[str, subprocess.Popen[str]] = {}
        try:
            for host in hosts:
                running[host] = subprocess.Popen(
                    ["ip", "netns", "exec", _namespace(host), *commands[host]],
                    cwd=folder,
                    env={**os.environ, "PYTHONPATH": str(ROOT), **(environment or {})},
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    text=True,
                )
            said = {host: run.communicate(timeout=WAIT_S)[0] for host, run in running.items()}
        except subprocess.TimeoutExpired as error:
            raise NetworkError(f"the hosts did not end within {WAIT_S:g} s") from error
        finally:
            for run in running.values():
                run.kill()
                run.wait()
    failed = {host: said[host] for host, run in running.items() if run.returncode != 0}
    if failed:
        raise NetworkError(f"hosts ended with an error: {failed}")
    return folder / METRICS


def _commands(scenario: Scenario, folder: Path, endpoint: str) -> dict[str, list[str]]:
    keys = folder / "keys"
    make_keys(keys, scenario.names)
    (folder / "scenario.yaml").write_text(yaml.safe_dump(scenario.model_dump(mode="json")))
    earshot = [sys.executable, "-m", "station.main"]
    world = ["world", "scenario.yaml", "--listen", endpoint, "--keys", str(keys), "--headless"]
    commands = {WORLD: [*earshot, *world, "--out", "out", "--json", METRICS]}
    for name in scenario.names:
        robot = ["robot", name, "--connect", endpoint, "--keys", str(key_path(keys, name))]
        commands[name] = [*earshot, *robot]
    return commands


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True, timeout=30)


def _namespace(host: str) -> str:
    return f"earshot-{os.getpid()}-{host}"


def _address(number: int) -> str:
    return f"10.77.0.{number}"


def _plug_in(number: int, host: str) -> None:
    """A cable from the switch to a new host."""
    switch, own = _namespace("switch"), _namespace(host)
    _ip("-n", own, "link", "set", "lo", "up")
    _ip("-n", switch, "link", "add", host, "type", "veth", "peer", "name", "eth0", "netns", own)
    _ip("-n", switch, "link", "set", host, "master", "bridge", "up")
    _ip("-n", own, "addr", "add", f"{_address(number)}/24", "dev", "eth0")
    _ip("-n", own, "link", "set", "eth0", "up")
