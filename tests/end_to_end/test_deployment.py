"""What stands in deploy/, as far as it can be tried without a network or a container engine."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from protocol.keys import make_keys
from station.free_port import free_port

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
LOCKS = ("requirements.lock", "requirements-dev.lock")
WAIT_S = 120.0


@pytest.fixture(scope="module")
def services() -> dict[str, Any]:
    compose = yaml.safe_load((DEPLOY / "docker-compose.yaml").read_text())
    found: dict[str, Any] = compose["services"]
    return found


def test_compose_names_a_world_and_its_robots(services: dict[str, Any]) -> None:
    assert set(services) == {"world", "r1", "r2", "r3"}
    assert len({service["image"] for service in services.values()}) == 1
    for name in ("r1", "r2", "r3"):
        assert services[name]["command"][:2] == ["robot", name]
        assert services[name]["secrets"] == [name]
        assert services[name]["depends_on"]["world"]["condition"] == "service_healthy"


def test_the_services_own_commands_run_side_by_side(
    services: dict[str, Any], tmp_path: Path
) -> None:
    """With host names mapped to the loopback, and a map that is done sooner."""
    make_keys(tmp_path / "keys", ("r1", "r2", "r3"))
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    running: dict[str, subprocess.Popen[str]] = {}
    try:
        for name, service in services.items():
            words = [_mapped(word, endpoint, tmp_path) for word in service["command"]]
            if name == "world":
                words += ["--map", "rooms-small", "--max-time", "5"]
            running[name] = subprocess.Popen(
                [sys.executable, "-m", "station.main", *words],
                cwd=tmp_path,
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
        output = {name: run.communicate(timeout=WAIT_S)[0] for name, run in running.items()}
    finally:
        for run in running.values():
            run.kill()
            run.wait()
    assert {name: run.returncode for name, run in running.items()} == dict.fromkeys(running, 0), (
        output
    )
    assert (tmp_path / "report" / "metrics.json").is_file()
    for name in ("r1", "r2", "r3"):
        assert "the run has ended" in output[name]


def _mapped(word: str, endpoint: str, folder: Path) -> str:
    word = re.sub(r"^tcp/[a-z0-9.]+:7447$", endpoint, word)
    word = re.sub(r"^/run/secrets/(\w+)$", rf"{folder}/keys/\1.key", word)
    word = re.sub(r"^/keys", f"{folder}/keys", word)
    return re.sub(r"^/runs", str(folder), word)


def test_the_image_is_not_root_and_compiles_ahead() -> None:
    lines = (DEPLOY / "Dockerfile").read_text().splitlines()
    user = lines.index("USER earshot")
    assert "RUN earshot warm-up" in lines[user:]
    assert any(line.startswith("ENTRYPOINT") for line in lines[user:])


@pytest.mark.parametrize("name", LOCKS)
def test_locks_have_hashes_and_no_host_names(name: str) -> None:
    text = (DEPLOY / name).read_text()
    assert not re.search(r"https?:|file:|--index-url|--find-links|^-f ", text, re.MULTILINE)
    for block in re.split(r"\n(?=\S)", text.strip()):
        assert re.match(r"[a-z0-9.\[\]-]+==\S+", block), block[:80]
        assert "--hash=sha256:" in block, block[:80]


def test_locks_hold_everything_that_the_project_names() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = {"requirements.lock": [*project["dependencies"], "setuptools"]}
    extra = project["optional-dependencies"]["dev"]
    wanted["requirements-dev.lock"] = [*wanted["requirements.lock"], *extra]
    for name, requirements in wanted.items():
        locked = set(re.findall(r"^([a-z0-9.-]+)==", (DEPLOY / name).read_text(), re.MULTILINE))
        names = {re.split(r"[^A-Za-z0-9_.-]", r)[0].lower() for r in requirements}
        assert names <= locked


def test_the_larger_lock_contains_the_smaller_one() -> None:
    small, large = (
        set(re.findall(r"^(\S+==\S+)", (DEPLOY / name).read_text(), re.MULTILINE)) for name in LOCKS
    )
    assert small <= large


@pytest.mark.parametrize(
    "script", ["deploy/run.sh", "deploy/test.sh", "deploy/setup.sh", ".ci/run"]
)
def test_scripts_are_plain_sh(script: str) -> None:
    subprocess.run(["sh", "-n", str(ROOT / script)], check=True, timeout=30)
    assert (ROOT / script).read_text().count("bash") == 0


def test_make_explains_its_targets() -> None:
    if not (ROOT / "Makefile").is_file():
        pytest.skip("no Makefile beside this installation")
    try:
        done = subprocess.run(
            ["make", "-C", str(ROOT), "help"],
            capture_output=True,
            text=True,
            timeout=30,
            check=True,
        )
    except FileNotFoundError:
        pytest.skip("make is not installed")
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"^\.PHONY: (\S+)", makefile, re.MULTILINE):
        assert re.search(rf"^  {target} +\S", done.stdout, re.MULTILINE), target
