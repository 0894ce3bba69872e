"""The base of every message and configuration, and arrays as fields of them."""

import math
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, BeforeValidator, ConfigDict, PlainSerializer


class Model(BaseModel):
    """Frozen, and unknown fields are refused; NaN is refused where a field does not allow it."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", arbitrary_types_allowed=True, allow_inf_nan=False
    )


class Message(Model):
    """A model that crosses the wire under a schema name and version (see `protocol.codec`)."""

    SCHEMA: ClassVar[str]
    VERSION: ClassVar[int] = 1


def _array_validator(dtype: str, *sizes: int | None) -> Any:
    """What makes an array of a field; `sizes` are its shape, None where any number will do."""
    wanted = np.dtype(dtype)

    def check_shape(shape: Sequence[int]) -> None:
        fits = len(shape) == len(sizes) and all(
            size is None or n == size for n, size in zip(shape, sizes, strict=True)
        )
        if not fits:
            spelt = " × ".join("n" if size is None else str(size) for size in sizes)
            raise ValueError(f"expected an array of {spelt}, got shape {tuple(shape)}")

    def check_values(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
        # Ranges, the only float32, are +inf where a beam meets nothing.
        if wanted.char == "d" and not np.isfinite(array).all():
            raise ValueError("expected finite numbers")
        return array

    def from_wire(value: dict[Any, Any]) -> npt.NDArray[Any]:
        if set(value) != {"d", "s", "b"}:
            raise ValueError("an array is {d: dtype, s: shape, b: bytes}")
        shape, data = value["s"], value["b"]
        if value["d"] != wanted.str or not isinstance(data, bytes):
            raise ValueError(f"expected bytes of dtype {wanted.str}")
        if not isinstance(shape, list | tuple) or not all(
            type(n) is int and 0 <= n <= 1 << 26 for n in shape
        ):
            raise ValueError("expected sizes as the shape")
        check_shape(shape)
        if math.prod(shape) * wanted.itemsize != len(data):
            raise ValueError(f"{len(data)} bytes do not fill shape {tuple(shape)}")
        return check_values(np.frombuffer(data, dtype=wanted).reshape(shape))

    def validate(value: object) -> npt.NDArray[Any]:
        if isinstance(value, dict):
            return from_wire(value)
        try:
            array = np.asarray(value, dtype=wanted)
        except (TypeError, OverflowError) as error:  # pydantic expects ValueError alone
            raise ValueError(f"expected numbers of dtype {wanted.str}") from error
        check_shape(array.shape)
        # Read-only exactly as after the wire, and no alias of what the sender goes on writing to.
        array = np.array(array, order="C", copy=True)
        array.setflags(write=False)
        return check_values(array)

    return validate


def _array_to_wire(array: npt.NDArray[Any]) -> dict[str, object]:
    return {"d": array.dtype.str, "s": list(array.shape), "b": array.tobytes()}


_TO_WIRE = PlainSerializer(_array_to_wire, return_type=dict)

Float32Vector = Annotated[
    npt.NDArray[np.float32], BeforeValidator(_array_validator("<f4", None)), _TO_WIRE
]
Float64Vector = Annotated[
    npt.NDArray[np.float64], BeforeValidator(_array_validator("<f8", None)), _TO_WIRE
]
Int64Vector = Annotated[
    npt.NDArray[np.int64], BeforeValidator(_array_validator("<i8", None)), _TO_WIRE
]
Int8Matrix = Annotated[
    npt.NDArray[np.int8], BeforeValidator(_array_validator("|i1", None, None)), _TO_WIRE
]
Points = Annotated[
    npt.NDArray[np.float64], BeforeValidator(_array_validator("<f8", None, 2)), _TO_WIRE
]
"""n×2: x, y (m)."""
Poses = Annotated[
    npt.NDArray[np.float64], BeforeValidator(_array_validator("<f8", None, 3)), _TO_WIRE
]
"""n×3: x, y (m), θ (rad)."""
Covariance = Annotated[
    npt.NDArray[np.float64], BeforeValidator(_array_validator("<f8", 3, 3)), _TO_WIRE
]
"""3×3, order (x, y, θ)."""
EdgeNodes = Annotated[
    npt.NDArray[np.int32], BeforeValidator(_array_validator("<i4", None, 2)), _TO_WIRE
]
"""k×2: the nodes that an edge ties together."""
EdgeValues = Annotated[
    npt.NDArray[np.float64], BeforeValidator(_array_validator("<f8", None, 9)), _TO_WIRE
]
"""k×9: measured (x, y, θ) and I11 I12 I13 I22 I23 I33."""
