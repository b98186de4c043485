"""Unpacks what bags are compressed by."""

from __future__ import annotations

import shutil
from importlib import import_module
from pathlib import Path
from typing import Any

from biosensor_gateway.recording.bag.errors import MessageError

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def unpack_zstd(packed: bytes, most: int) -> bytes:
    """Unpack a frame of zstd; at most so many bytes of it.

    Raises
    ------
    MessageError
        If it is none.
    """
    zstd = _zstd()
    try:
        return zstd.ZstdDecompressor().decompress(packed, max_length=most)
    except (zstd.ZstdError, EOFError, ValueError) as error:
        raise MessageError("it cannot be unpacked") from error


def unpack_zstd_file(packed: Path, target: Path) -> None:
    """Unpack a file of zstd into another one, piece by piece.

    Raises
    ------
    MessageError
        If it is none, or damaged; what came before is unpacked.
    OSError
        If one cannot be read or the other not be written.
    """
    zstd = _zstd()
    with target.open("wb") as unpacked:
        try:
            with zstd.open(packed, "rb") as file:
                shutil.copyfileobj(file, unpacked)
        except (zstd.ZstdError, EOFError) as error:
            raise MessageError("not all of it can be unpacked") from error


def unpack_lz4(packed: bytes, most: int) -> bytes:
    """Unpack a frame of lz4; at most so many bytes of it.

    Raises
    ------
    MessageError
        If it is none.
    """
    lz4: Any = import_module("lz4.frame")
    try:
        return lz4.LZ4FrameDecompressor().decompress(packed, max_length=most)
    except (RuntimeError, EOFError, ValueError) as error:
        raise MessageError("it cannot be unpacked") from error


def _zstd() -> Any:
    try:
        return import_module("compression.zstd")
    except ImportError:
        # Of Python before 3.14.
        return import_module("backports.zstd")
