"""Vectors of Polar's measurement data service, for the corpora of both its characteristics."""

from __future__ import annotations

from collections.abc import Iterator

from tests.fuzz.seeding import vectors

_DATA = "fb005c82-02e7-f387-1cad-8acd2d8df0c8"


def pmd_vectors(*, on_data: bool) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of what the vectors say of the data, or of the control point."""
    for name in ("polar_pmd_h10", "polar_pmd_verity"):
        for vector in vectors(f"polar_h10/vectors/{name}.json"):
            if vector["hex"] and (vector["characteristic"] == _DATA) is on_data:
                yield vector["name"], bytes.fromhex(vector["hex"])
