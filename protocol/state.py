"""Checkpoints: our own objects to bytes and back, without pickle.

`dump_state` walks plain attributes: numbers, strings, bytes, numpy arrays, lists, tuples, dicts,
sets, deques, enums, and instances of classes of this project. What cannot be stored (an executor,
a factorised matrix) is named in the class attribute `TRANSIENT` and comes back as None. Shared
references stay shared. `load_state` makes instances only of classes from `PACKAGES`, without
calling anything of theirs: a checkpoint from a stranger can be wrong, but it cannot run code.
"""

import sys
from collections import deque
from enum import Enum
from typing import Any, TypeVar

import msgpack
import numpy as np
from pydantic import BaseModel

from protocol.environment import PACKAGES
from protocol.errors import EarshotError

T = TypeVar("T")


class StateError(EarshotError):
    """A checkpoint that cannot be written or read."""


def dump_state(root: object) -> bytes:
    """The state of an object and of all it holds. Raises StateError on what cannot be stored."""
    packed: bytes = msgpack.packb(_Dumper().dump(root), use_bin_type=True)
    return packed


def load_state(data: bytes, kind: type[T]) -> T:
    """The object in a checkpoint. Raises StateError unless it is one of `kind`."""
    try:
        root = _Loader().load(msgpack.unpackb(data, raw=False, strict_map_key=False))
    except StateError:
        raise
    except Exception as error:  # whatever a damaged checkpoint leads to means the same
        raise StateError(f"the checkpoint is damaged: {error}") from error
    if not isinstance(root, kind):
        raise StateError(f"the checkpoint holds a {type(root).__name__}, not a {kind.__name__}")
    return root


def adopt_state(target: T, data: bytes) -> None:
    """Make `target` what the checkpoint of such an object says; keep its transient attributes."""
    loaded = load_state(data, type(target))
    transient = _transient(type(target))
    for name, value in _attributes(loaded).items():
        if name not in transient:
            object.__setattr__(target, name, value)


def _transient(cls: type) -> frozenset[str]:
    return frozenset(name for base in cls.__mro__ for name in getattr(base, "TRANSIENT", ()))


def _attributes(value: object) -> dict[str, Any]:
    found = dict(getattr(value, "__dict__", {}))
    for base in type(value).__mro__:
        slots = base.__dict__.get("__slots__", ())
        for name in (slots,) if isinstance(slots, str) else slots:
            if name not in ("__dict__", "__weakref__") and hasattr(value, name):
                found[name] = getattr(value, name)
    return found


class _Dumper:
    """Containers become tagged lists; what was met before becomes a reference to its number."""

    def __init__(self) -> None:
        self._seen: dict[int, int] = {}
        self._keep: list[object] = []  # ids stay unique only while the objects live

    def dump(self, value: Any) -> Any:
        if value is None or (
            isinstance(value, bool | str | bytes | float)
            and not isinstance(value, np.generic | Enum)
        ):
            return value
        if type(value) is int:
            return value if -(2**63) <= value < 2**64 else ["i", str(value)]
        if isinstance(value, Enum):
            return ["e", _path(type(value)), value.name]
        if isinstance(value, np.generic):
            return ["n", value.dtype.str, value.tobytes()]
        if type(value) is tuple:
            return ["u", *map(self.dump, value)]
        if id(value) in self._seen:
            return ["@", self._seen[id(value)]]
        self._seen[id(value)] = len(self._seen)
        self._keep.append(value)
        return self._dump_shared(value)

    def _dump_shared(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            if value.dtype.hasobject:
                raise StateError("an array of objects cannot be stored")
            data = np.ascontiguousarray(value).tobytes()
            return ["a", value.dtype.str, list(value.shape), data, value.flags.writeable]
        if type(value) is list:
            return ["l", *map(self.dump, value)]
        if type(value) is dict:
            return ["d", *(self.dump(part) for pair in value.items() for part in pair)]
        if type(value) is deque:
            return ["q", value.maxlen, *map(self.dump, value)]
        if type(value) in (set, frozenset):
            return ["s", type(value) is set, *map(self.dump, sorted(value))]
        cls = type(value)
        if cls.__module__.split(".")[0] not in PACKAGES:
            raise StateError(f"a {cls.__module__}.{cls.__qualname__} cannot be stored")
        if isinstance(value, tuple):  # a named tuple
            return ["t", _path(cls), *map(self.dump, value)]
        transient = _transient(cls)
        fields = {
            name: None if name in transient else self.dump(held)
            for name, held in _attributes(value).items()
        }
        return ["o", _path(cls), fields]


class _Loader:
    def __init__(self) -> None:
        self._seen: list[Any] = []

    def load(self, packed: Any) -> Any:
        if not isinstance(packed, list):
            return packed
        tag, *rest = packed
        if tag == "i":
            return int(rest[0])
        if tag == "e":
            return _class(rest[0], Enum)[rest[1]]
        if tag == "n":
            return np.frombuffer(rest[1], dtype=np.dtype(rest[0]))[0]
        if tag == "u":
            return tuple(map(self.load, rest))
        if tag == "@":
            return self._seen[rest[0]]
        return self._load_shared(tag, rest)

    def _load_shared(self, tag: str, rest: list[Any]) -> Any:
        place = len(self._seen)
        self._seen.append(None)
        value: Any
        if tag == "a":
            dtype, shape, data, writeable = rest
            value = np.frombuffer(data, dtype=np.dtype(dtype)).reshape(shape)
            value = value.copy() if writeable else value
            self._seen[place] = value
        elif tag == "l":
            value = self._seen[place] = []
            value.extend(map(self.load, rest))
        elif tag == "d":
            value = self._seen[place] = {}
            parts = [self.load(part) for part in rest]
            value.update(zip(parts[::2], parts[1::2], strict=True))
        elif tag == "q":
            value = self._seen[place] = deque(maxlen=rest[0])
            value.extend(map(self.load, rest[1:]))
        elif tag == "s":
            members = map(self.load, rest[1:])
            value = self._seen[place] = set(members) if rest[0] else frozenset(members)
        elif tag == "t":
            value = self._seen[place] = _class(rest[0], tuple)(*map(self.load, rest[1:]))
        elif tag == "o":
            value = self._load_object(place, rest[0], rest[1])
        else:
            raise StateError(f"the checkpoint is damaged: unknown tag {tag!r}")
        return value

    def _load_object(self, place: int, path: str, fields: dict[str, Any]) -> Any:
        cls = _class(path, object)
        if issubclass(cls, BaseModel):
            held = {name: self.load(value) for name, value in fields.items()}
            value: Any = cls.model_construct(**held)
            self._seen[place] = value
            return value
        value = self._seen[place] = object.__new__(cls)
        for name, packed in fields.items():
            object.__setattr__(value, name, self.load(packed))
        return value


def _path(cls: type) -> str:
    return f"{cls.__module__}:{cls.__qualname__}"


def _class(path: str, kind: type) -> Any:
    module_name, _, name = path.partition(":")
    if module_name.split(".")[0] not in PACKAGES:
        raise StateError(f"the checkpoint names a class that is not ours: {path}")
    module = sys.modules.get(module_name)
    found: Any = module
    for part in name.split("."):
        found = getattr(found, part, None)
    if not isinstance(found, type) or not issubclass(found, kind):
        raise StateError(f"the checkpoint names an unknown class: {path}")
    return found
