"""Keys: what a robot proves to the router that it is the one whose name it bears.

A folder of keys holds `NAME.key` for each robot and one for the station (JSON, mode 0600, to be
taken to the machine of that robot and to no other), and `users`, the router's list of them all.
The password itself never crosses the wire: Zenoh answers a challenge with it.
"""

import os
import secrets
from collections.abc import Sequence
from pathlib import Path

from pydantic import Field, ValidationError

from protocol.access import STATION_USER
from protocol.errors import EarshotError
from protocol.model import Model

USERS = "users"
PASSWORD_BYTES = 32


class KeysError(EarshotError):
    """Keys that cannot be read or written, or are not there."""


class Key(Model):
    """One user's name and password."""

    user: str = Field(pattern=r"^@?[a-z][a-z0-9_-]{0,31}$")
    password: str = Field(pattern=r"^[0-9a-f]{16,}$", repr=False)


def make_keys(folder: Path, names: Sequence[str]) -> list[Path]:
    """Make keys for robots and the station in a folder; whose key is there already keeps it.

    Returns the files that are new. The folder is made with mode 0700. Raises KeysError.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        made = []
        for user in (*names, STATION_USER):
            path = key_path(folder, user)
            if not path.exists():
                key = Key(user=user, password=secrets.token_hex(PASSWORD_BYTES))
                _write_private(path, key.model_dump_json() + "\n")
                made.append(path)
        keys = [read_key(path) for path in sorted(folder.glob("*.key"))]
        _write_private(folder / USERS, "".join(f"{key.user}:{key.password}\n" for key in keys))
    except OSError as error:
        raise KeysError(f"cannot keep keys in {folder}: {error.strerror}") from None
    except ValidationError:
        raise KeysError(
            f"{user} cannot be a robot's name: lower-case letters, digits, - and _ alone"
        ) from None
    return made


def key_path(folder: Path, user: str) -> Path:
    return folder / f"{user}.key"


def read_key(path: Path) -> Key:
    """The key in a file. Raises KeysError."""
    try:
        return Key.model_validate_json(path.read_bytes())
    except OSError as error:
        raise KeysError(f"cannot read the key {path}: {error.strerror}") from None
    except ValidationError:
        raise KeysError(f"{path} is not a key: make one with `earshot keys NAME`") from None


def users_file(folder: Path, names: Sequence[str]) -> Path:
    """The router's list of users. Raises KeysError, unless all these robots are in it."""
    path = folder / USERS
    try:
        users = {line.partition(":")[0] for line in path.read_text().splitlines()}
    except OSError as error:
        raise KeysError(
            f"no keys in {folder}: {error.strerror}; {_advice(folder, names)}"
        ) from None
    missing = [name for name in names if name not in users]
    if missing:
        raise KeysError(f"{folder} has no key of {', '.join(missing)}; {_advice(folder, missing)}")
    return path


def _advice(folder: Path, names: Sequence[str]) -> str:
    return f"make them with `earshot keys {' '.join(names)} --out {folder}`"


def _write_private(path: Path, text: str) -> None:
    """Write a file that only its owner can read, at no moment anybody else."""
    part = path.with_name(path.name + ".part")
    part.unlink(missing_ok=True)
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(text)
    part.replace(path)
