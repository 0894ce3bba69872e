"""Grey images of maps: 8-bit PGM read and written here, everything else read through OpenCV."""

import importlib
import os
import re
import tempfile
from pathlib import Path

import numpy as np
import numpy.typing as npt

from protocol.errors import EarshotError

PixelArray = npt.NDArray[np.uint8]

# 10,000 × 10,000 cells are 500 × 500 m at 5 cm; more is a damaged header or the wrong file.
MAX_PIXELS = 100_000_000

# P5, width, height and maximum, with comments between them, then one white space.
_PGM_HEADER = re.compile(rb"P5" + rb"(?:\s|#[^\n]*\n)+(\d+)" * 3 + rb"\s")


class MapFileError(EarshotError):
    """A map file that cannot be read; the message names the file and says what was expected."""


def read_pixels(path: Path) -> PixelArray:
    """Read an image as 8-bit grey, h×w, row 0 at the top.

    Raises MapFileError when it is missing, damaged, empty, too large or no image.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MapFileError(f"{path}: cannot read the image ({error.strerror})") from error
    return _parse_pgm(path, data) if data.startswith(b"P5") else _decode(path, data)


def _parse_pgm(path: Path, data: bytes) -> PixelArray:
    header = _PGM_HEADER.match(data)
    if header is None:
        raise MapFileError(f"{path}: expected a PGM header: P5, width, height, 255")
    width, height, maximum = (int(digits[:9]) for digits in header.groups())
    if maximum != 255:
        raise MapFileError(f"{path}: expected 8-bit grey with maximum 255, got {maximum}")
    _check_size(path, height, width)
    if len(data) - header.end() < width * height:
        raise MapFileError(
            f"{path}: {width} x {height} pixels announced, "
            f"{len(data) - header.end()} found: the file is cut off"
        )
    pixels = np.frombuffer(data, dtype=np.uint8, count=width * height, offset=header.end())
    return pixels.reshape(height, width)


def _decode(path: Path, data: bytes) -> PixelArray:
    if not data:
        raise MapFileError(f"{path}: the image is empty")
    # By name: robots import maps.grid and must stay free of OpenCV, which they never need.
    cv2 = importlib.import_module("cv2")
    try:
        pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error as error:  # refuses images of more than 2^30 pixels by itself
        raise MapFileError(f"{path}: the image cannot be decoded ({error.err})") from error
    if pixels is None:
        raise MapFileError(f"{path}: expected a PGM (P5) or PNG image")
    _check_size(path, *pixels.shape)
    return np.asarray(pixels, dtype=np.uint8)


def _check_size(path: Path, height: int, width: int) -> None:
    if width == 0 or height == 0:
        raise MapFileError(f"{path}: the image has no pixels ({width} x {height})")
    if width * height > MAX_PIXELS:
        raise MapFileError(
            f"{path}: {width} x {height} pixels are more than {MAX_PIXELS // 1_000_000} million"
        )


def pgm_bytes(pixels: PixelArray) -> bytes:
    """A binary PGM file of h×w pixels, row 0 at the top."""
    height, width = pixels.shape
    return f"P5\n{width} {height}\n255\n".encode() + np.ascontiguousarray(pixels).tobytes()


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that a reader sees the old one or the new one, never a part.

    Raises MapFileError when the folder cannot be written.
    """
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        temporary = Path(name)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            temporary.chmod(0o644)  # mkstemp makes files that nobody else may read
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise MapFileError(f"{path}: cannot be written ({error.strerror})") from error
