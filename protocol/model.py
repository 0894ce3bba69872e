"""The base of every message and configuration, and arrays as fields of them."""

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


def _array_validator(dtype: str, ndim: int) -> Any:
    wanted = np.dtype(dtype)

    def validate(value: object) -> npt.NDArray[Any]:
        if isinstance(value, dict):  # as it comes from the wire
            if set(value) != {"d", "s", "b"}:
                raise ValueError("an array is {d: dtype, s: shape, b: bytes}")
            shape, data = value["s"], value["b"]
            if value["d"] != wanted.str or not isinstance(data, bytes):
                raise ValueError(f"expected bytes of dtype {wanted.str}")
            if (
                not isinstance(shape, list | tuple)
                or len(shape) != ndim
                or not all(type(n) is int and 0 <= n <= 1 << 26 for n in shape)
            ):
                raise ValueError(f"expected {ndim} sizes as the shape")
            count = 1
            for n in shape:
                count *= n
            if count * wanted.itemsize != len(data):
                raise ValueError(f"{len(data)} bytes do not fill shape {tuple(shape)}")
            return np.frombuffer(data, dtype=wanted).reshape(shape)
        try:
            array = np.asarray(value, dtype=wanted)
        except (TypeError, OverflowError) as error:  # pydantic expects ValueError alone
            raise ValueError(f"expected numbers of dtype {wanted.str}") from error
        if array.ndim != ndim:
            raise ValueError(f"expected {ndim} dimensions, got {array.ndim}")
        # Read-only exactly as after the wire, and no alias of what the sender goes on writing to.
        array = np.array(array, order="C", copy=True)
        array.setflags(write=False)
        return array

    return validate


def _array_to_wire(array: npt.NDArray[Any]) -> dict[str, object]:
    return {"d": array.dtype.str, "s": list(array.shape), "b": array.tobytes()}


_TO_WIRE = PlainSerializer(_array_to_wire, return_type=dict)

Float32Vector = Annotated[
    npt.NDArray[np.float32], BeforeValidator(_array_validator("<f4", 1)), _TO_WIRE
]
Float64Vector = Annotated[
    npt.NDArray[np.float64], BeforeValidator(_array_validator("<f8", 1)), _TO_WIRE
]
Float64Matrix = Annotated[
    npt.NDArray[np.float64], BeforeValidator(_array_validator("<f8", 2)), _TO_WIRE
]
Int32Matrix = Annotated[
    npt.NDArray[np.int32], BeforeValidator(_array_validator("<i4", 2)), _TO_WIRE
]
Int64Vector = Annotated[
    npt.NDArray[np.int64], BeforeValidator(_array_validator("<i8", 1)), _TO_WIRE
]
Int8Matrix = Annotated[npt.NDArray[np.int8], BeforeValidator(_array_validator("|i1", 2)), _TO_WIRE]
