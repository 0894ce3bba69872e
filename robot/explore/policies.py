"""The exploration policies by name, and loading one that a user wrote.

A policy that comes as `path/to/file.py:ClassName` is a class that can be made without arguments
and has the `plan` of `robot.explore.policy.Policy`.
"""

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path

from protocol.errors import EarshotError
from robot.explore.nearest import NearestFrontier
from robot.explore.patrol import Patrol
from robot.explore.policy import Policy

POLICIES: dict[str, Callable[[], Policy]] = {
    "frontier": NearestFrontier,
    "patrol": Patrol,
}


class PolicyError(EarshotError):
    """A policy that cannot be had; the message says what was looked for and what there is."""


def make_policy(name: str) -> Policy:
    """The policy of that name, or of the class in `path/to/file.py:ClassName`.

    Raises PolicyError when there is no such policy, file or class, or when it does not load.
    """
    if name in POLICIES:
        return POLICIES[name]()
    file, colon, class_name = name.rpartition(":")
    if not colon or not file.endswith(".py"):
        raise PolicyError(
            f"no policy {name!r}; there are {', '.join(sorted(POLICIES))}, "
            "or name your own as path/to/file.py:ClassName"
        )
    return _load(Path(file), class_name)


def _load(path: Path, class_name: str) -> Policy:
    if not path.is_file():
        raise PolicyError(f"policy file {path} does not exist")
    module_name = f"earshot_policy_{path.stem}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None:
        raise PolicyError(f"policy file {path} is not a Python module")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses look their module up by name
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise PolicyError(f"policy file {path} does not load: {error!r}") from error
    maker = getattr(module, class_name, None)
    if not isinstance(maker, type):
        classes = sorted(key for key, value in vars(module).items() if isinstance(value, type))
        raise PolicyError(
            f"policy file {path} has no class {class_name!r}; it has {', '.join(classes) or 'none'}"
        )
    try:
        policy = maker()
    except Exception as error:
        raise PolicyError(f"policy {class_name} in {path} cannot be made: {error!r}") from error
    if not callable(getattr(policy, "plan", None)):
        raise PolicyError(f"policy {class_name} in {path} has no method plan(view)")
    loaded: Policy = policy
    return loaded
