"""Lines that no client should trip over."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_STAMP = "1680442024,64479"
_DAMAGED: Sequence[bytes] = tuple(
    line.encode()
    for line in (
        "E4_Bvp 16804420",
        f"E4_Bvp {_STAMP}",
        f"E4_Bvp {_STAMP} NaN",
        f"E4_Bvp {_STAMP} -Infinity",
        f"E4_Acc {_STAMP} 1 2",
        f"E4_Gsr {_STAMP} 0,08 0,09",
        f"E4_Gsr {_STAMP} abc",
        "E4_Bvp 1680442024,64,479 1,0",
        f"E4_Foo {_STAMP} 1,0",
        f"E4_Bvp {_STAMP} 21,54169E4_Bvp 1680442024,66041 20,6037",
        "4479 21,5",
        "hello world",
        "R",
        "R device_frobnicate OK",
        "R device_list x",
        "R device_list 2 | 9ff167 Empatica_E4",
    )
)
_BROKEN_TEXT = b"E4\xff_Bvp 1680442024,6 1\xc3"


def damaged_line(rng: np.random.Generator) -> bytes:
    """One damaged line, with its end."""
    kind = int(rng.integers(len(_DAMAGED) + 2))
    if kind < len(_DAMAGED):
        return _DAMAGED[kind] + b"\r\n"
    if kind == len(_DAMAGED):
        return _BROKEN_TEXT + b"\r\n"
    return rng.bytes(48).replace(b"\n", b"\0") + b"\r\n"
