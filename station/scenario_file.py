"""Scenario files, and scenarios with some of their values changed."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from protocol.errors import EarshotError
from world.scenario import Scenario


class ScenarioFileError(EarshotError):
    """What was given is not a scenario; the message names the field."""


def read_scenario(path: Path) -> Scenario:
    """Read a YAML or JSON scenario. A map's path may be relative to the scenario's folder."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioFileError(f"{path}: cannot be read: {error}") from None
    try:
        fields = json.loads(text) if path.suffix == ".json" else yaml.safe_load(text)
    except (yaml.YAMLError, ValueError) as error:
        raise ScenarioFileError(f"{path}: {' '.join(str(error).split())}") from None
    if not isinstance(fields, dict):
        raise ScenarioFileError(f"{path}: expected a mapping such as `map: office`")
    beside = path.parent / str(fields.get("map", ""))
    if "map" in fields and beside.is_file():
        fields = {**fields, "map": str(beside)}
    return _validated(fields, str(path))


def changed(
    scenario: Scenario,
    changes: Mapping[str, Any],
    robots: int | None = None,
    engine: str | None = None,
    policy: str | None = None,
) -> Scenario:
    """A scenario with new values; None, at any depth, leaves a value as it is.

    With `robots` the first so many stay, and further ones are named r1, r2, … as far as free.
    """
    fields = _merged(scenario.model_dump(), changes)
    if robots is not None:
        fields["robots"] = _team(list(fields["robots"]), robots)
    for robot in fields["robots"]:
        robot.update({} if engine is None else {"engine": engine})
        robot.update({} if policy is None else {"policy": policy})
    return _validated(fields, "options")


def _merged(fields: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(fields)
    for key, value in changes.items():
        if isinstance(value, Mapping):
            merged[key] = _merged(fields[key], value)
        elif value is not None:
            merged[key] = value
    return merged


def _team(robots: list[dict[str, Any]], count: int) -> list[dict[str, Any]]:
    team = robots[: max(count, 0)]
    taken = {robot["name"] for robot in team}
    number = 1
    while len(team) < count:
        name = f"r{number}"
        if name not in taken:
            team.append({"name": name})
        number += 1
    return team


def _validated(fields: Mapping[str, Any], source: str) -> Scenario:
    try:
        return Scenario.model_validate(fields)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ScenarioFileError(
            f"{source}: {place + ': ' if place else ''}{first['msg']}"
        ) from None
