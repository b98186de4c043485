"""``python -m installer.pictures FOLDER``: draws the icon and the installer's two pictures.

All show the heart beat of ``docs/pictures/icon.svg``. The pictures have twice the size of
what NSIS shows at 100 %, so that they are sharp on screens of a high resolution.

Layouts: Microsoft's "Icons" (ICONDIR), BITMAPINFOHEADER, and the PNG specification.
"""

from __future__ import annotations

import struct
import sys
import zlib
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.float64]
"""Height, width, and red, green, blue and opacity from 0 to 1."""

ICON, WELCOME, HEADER = "icon.ico", "welcome.bmp", "header.bmp"
ICON_SIZES = (16, 20, 24, 32, 40, 48, 64, 256)
WELCOME_SIZE, HEADER_SIZE = (328, 628), (300, 114)

_TEAL, _DARK, _WHITE = (0.0, 0.475, 0.420), (0.0, 0.302, 0.251), (1.0, 1.0, 1.0)
# Of the SVG, whose side is 24.
_SIDE, _STROKE = 24.0, 2.2
_BEAT = ((1, 13), (6, 13), (8, 10), (10, 13), (11, 13), (13, 4), (16, 19), (18, 13), (23, 13))
# From this size on, PNG: as a bitmap it would be a quarter of a megabyte.
_PNG_FROM = 256


def main() -> None:
    """Draw all three."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    draw(folder)


def draw(folder: Path) -> None:
    """Write the files into a folder."""
    (folder / ICON).write_bytes(icon())
    (folder / WELCOME).write_bytes(_bitmap(_welcome(*WELCOME_SIZE)))
    (folder / HEADER).write_bytes(_bitmap(_header(*HEADER_SIZE)))


def icon() -> bytes:
    """Return an icon of all sizes."""
    images = [_png(_tile(size)) if size >= _PNG_FROM else _dib(_tile(size)) for size in ICON_SIZES]
    at = 6 + 16 * len(images)
    entries = b""
    for size, image in zip(ICON_SIZES, images, strict=True):
        entries += struct.pack("<BBBBHHII", size % 256, size % 256, 0, 0, 1, 32, len(image), at)
        at += len(image)
    return struct.pack("<HHH", 0, 1, len(images)) + entries + b"".join(images)


# ---- What is drawn


def _tile(size: int) -> Pixels:
    """Draw the beat in white on a square with round corners."""
    picture = np.zeros((size, size, 4))
    picture[..., :3] = _TEAL
    picture[..., 3] = _coverage(_outside_rounded(size, size * 0.2))
    margin = 0.12 * size
    _stroke(picture, (margin, margin), size - 2 * margin, _WHITE)
    return picture


def _welcome(width: int, height: int) -> Pixels:
    picture = _plain(width, height, _TEAL)
    shade = np.linspace(0.0, 1.0, height)[:, None, None]
    picture[..., :3] = (1 - shade) * np.array(_TEAL) + shade * np.array(_DARK)
    side = 0.8 * width
    _stroke(picture, ((width - side) / 2, (height - side) / 2), side, _WHITE)
    return picture


def _header(width: int, height: int) -> Pixels:
    picture = _plain(width, height, _WHITE)
    side = 0.8 * height
    _stroke(picture, (width - side - 0.1 * height, 0.1 * height), side, _TEAL)
    return picture


def _plain(width: int, height: int, colour: tuple[float, float, float]) -> Pixels:
    picture = np.ones((height, width, 4))
    picture[..., :3] = colour
    return picture


def _stroke(
    picture: Pixels,
    corner: tuple[float, float],
    side: float,
    colour: tuple[float, float, float],
) -> None:
    """Draw the beat into a square of *side* pixels whose upper left *corner* is ``(x, y)``."""
    scale = side / _SIDE
    points = [(corner[0] + x * scale, corner[1] + y * scale) for x, y in _BEAT]
    grid = _centres(*picture.shape[:2])
    distance = np.min([_to_segment(grid, *ends) for ends in pairwise(points)], axis=0)
    # Thinner than a pixel and a half it would fade.
    amount = _coverage(distance - max(_STROKE * scale, 1.5) / 2)[..., None]
    picture[..., :3] = amount * np.array(colour) + (1 - amount) * picture[..., :3]


def _centres(height: int, width: int) -> tuple[Pixels, Pixels]:
    y, x = np.mgrid[0:height, 0:width] + 0.5
    return x, y


def _coverage(distance: Pixels) -> Pixels:
    """How much of a pixel is covered, by the distance of its centre from the edge."""
    return np.clip(0.5 - distance, 0.0, 1.0)


def _to_segment(
    grid: tuple[Pixels, Pixels], start: tuple[float, float], end: tuple[float, float]
) -> Pixels:
    along = np.subtract(end, start)
    x, y = grid[0] - start[0], grid[1] - start[1]
    share = np.clip((x * along[0] + y * along[1]) / np.dot(along, along), 0.0, 1.0)
    return np.hypot(x - share * along[0], y - share * along[1])


def _outside_rounded(size: int, radius: float) -> Pixels:
    x, y = (np.abs(each - size / 2) - (size / 2 - radius) for each in _centres(size, size))
    return np.hypot(np.maximum(x, 0), np.maximum(y, 0)) + np.minimum(np.maximum(x, y), 0) - radius


# ---- How it is written


def _levels(picture: Pixels) -> NDArray[np.uint8]:
    return np.round(picture * 255).astype(np.uint8)


def _dib(picture: Pixels) -> bytes:
    """Return an image of an icon: upside down, blue first, and a mask that says nothing."""
    size = len(picture)
    head = struct.pack("<IiiHHIIiiII", 40, size, 2 * size, 1, 32, 0, 0, 0, 0, 0, 0)
    mask = bytes(-(-size // 32) * 4 * size)
    return head + _levels(picture)[::-1, :, [2, 1, 0, 3]].tobytes() + mask


def _bitmap(picture: Pixels) -> bytes:
    height, width = picture.shape[:2]
    rows = _levels(picture)[::-1, :, [2, 1, 0]].reshape(height, width * 3)
    body = np.pad(rows, ((0, 0), (0, -width * 3 % 4))).tobytes()
    head = struct.pack("<IiiHHIIiiII", 40, width, height, 1, 24, 0, len(body), 0, 0, 0, 0)
    return struct.pack("<2sIHHI", b"BM", 54 + len(body), 0, 0, 54) + head + body


def _png(picture: Pixels) -> bytes:
    height, width = picture.shape[:2]
    rows = np.pad(_levels(picture).reshape(height, width * 4), ((0, 0), (1, 0))).tobytes()
    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", zlib.compress(rows, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in parts
    )


if __name__ == "__main__":
    main()
