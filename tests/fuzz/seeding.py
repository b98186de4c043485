"""What makes seeds of vectors."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, cast

from tests.fuzz.streams import join_counted

TESTS = Path(__file__).parents[1]

Seeds = Iterator[tuple[str, bytes]]


def vectors(path: str) -> list[dict[str, Any]]:
    """Return the vectors of a file below `tests`."""
    content = json.loads((TESTS / path).read_text(encoding="utf-8"))
    return cast(
        "list[dict[str, Any]]", content if isinstance(content, list) else content["vectors"]
    )


def hex_of(found: Iterable[dict[str, Any]]) -> Seeds:
    """Name and bytes of the vectors that have any."""
    for vector in found:
        if vector.get("hex"):
            yield vector["name"], bytes.fromhex(vector["hex"])


def counted(named: Iterable[tuple[str, bytes]]) -> Seeds:
    """Each as one piece, twice, and all together, for targets that read pieces."""
    found = list(named)
    for name, data in found:
        yield name, join_counted([data])
        yield f"{name}_twice", join_counted([data, data])
    yield "all", join_counted([data for _, data in found])
