"""Unpacks what bags are compressed by."""

from __future__ import annotations

from importlib import import_module
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
