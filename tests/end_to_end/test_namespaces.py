"""The fourth way to run: world and robots as hosts of their own on one network.

Each is in a network namespace with an address of its own, joined by a bridge in yet another one:
nothing but packets through the world's router can pass between them.
"""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import yaml

from protocol.keys import key_path, make_keys
from station.hashes import run_hashes
from station.launch import launch
from world.scenario import PaceConfig, RobotSpec, Scenario

ROOT = Path(__file__).resolve().parents[2]
WAIT_S = 120.0
HOSTS = ("world", "r1", "r2")
SCENARIO = Scenario(
    map="rooms-small",
    seed=3,
    robots=(RobotSpec(name="r1"), RobotSpec(name="r2")),
    max_sim_s=12.0,
    pace=PaceConfig(deadline_s=60.0),
)


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True, timeout=30)


def namespace(host: str) -> str:
    return f"earshot-{os.getpid()}-{host}"


def in_namespace(host: str, *command: str) -> list[str]:
    return ["ip", "netns", "exec", namespace(host), *command]


def plug_in(number: int, host: str) -> None:
    """A cable from the switch to a new host with the address 10.77.0.`number`."""
    switch, own = namespace("switch"), namespace(host)
    ip("-n", own, "link", "set", "lo", "up")
    ip("-n", switch, "link", "add", host, "type", "veth", "peer", "name", "eth0", "netns", own)
    ip("-n", switch, "link", "set", host, "master", "bridge", "up")
    ip("-n", own, "addr", "add", f"10.77.0.{number}/24", "dev", "eth0")
    ip("-n", own, "link", "set", "eth0", "up")


@pytest.fixture
def network() -> Iterator[dict[str, str]]:
    """Hosts and their addresses. Namespaces go with everything in them."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        pytest.skip("network namespaces need root and the ip command")
    with ExitStack() as stack:
        try:
            for host in ("switch", *HOSTS):
                ip("netns", "add", namespace(host))
                stack.callback(ip, "netns", "del", namespace(host))
            ip("-n", namespace("switch"), "link", "add", "bridge", "type", "bridge")
            ip("-n", namespace("switch"), "link", "set", "bridge", "up")
            for number, host in enumerate(HOSTS, start=1):
                plug_in(number, host)
        except subprocess.CalledProcessError as error:
            pytest.skip(f"network namespaces are not allowed here: {error.stderr.strip()}")
        yield {host: f"10.77.0.{number}" for number, host in enumerate(HOSTS, start=1)}


def test_on_hosts_of_their_own_the_run_is_the_same(network: dict[str, str], tmp_path: Path) -> None:
    make_keys(tmp_path / "keys", SCENARIO.names)
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(SCENARIO.model_dump(mode="json")))
    endpoint = f"tcp/{network['world']}:7447"
    words = {
        "world": ["scenario.yaml", "--listen", endpoint, "--keys", "keys", "--headless"],
        **{
            name: [name, "--connect", endpoint, "--keys", str(key_path(Path("keys"), name))]
            for name in SCENARIO.names
        },
    }
    words["world"] += ["--out", "out", "--json", "metrics.json"]
    running: dict[str, subprocess.Popen[str]] = {}
    try:
        for host in HOSTS:
            command = "world" if host == "world" else "robot"
            running[host] = subprocess.Popen(
                in_namespace(host, sys.executable, "-m", "station.main", command, *words[host]),
                cwd=tmp_path,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
        output = {host: run.communicate(timeout=WAIT_S)[0] for host, run in running.items()}
    finally:
        for run in running.values():
            run.kill()
            run.wait()
    assert {host: run.returncode for host, run in running.items()} == dict.fromkeys(HOSTS, 0), (
        output
    )
    hashes = json.loads((tmp_path / "metrics.json").read_text())["hashes"]
    assert hashes == run_hashes(launch(SCENARIO, "inline"))
