"""The vectors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors/muse.json").read_text(encoding="utf-8")
)


def of_kind(*kinds: str) -> pytest.MarkDecorator:
    """Run a test for each vector of these kinds."""
    found = [vector for vector in VECTORS if vector["kind"] in kinds]
    assert found
    return pytest.mark.parametrize("vector", found, ids=[vector["name"] for vector in found])


def bytes_of(vector: dict[str, Any]) -> bytes:
    return bytes.fromhex(vector["hex"])


def bytes_named(name: str) -> bytes:
    (found,) = (bytes_of(vector) for vector in VECTORS if vector["name"] == name)
    return found
