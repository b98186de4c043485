"""Chooses which stream of a device each feature is computed of."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.features.outputs import READ_TYPES
from biosensor_gateway.features.sources import Source

Taken = set[tuple[DeviceIdentity, str]]
"""Devices, each with the data name of a feature that somebody computes."""


def choose(sources: Iterable[Source], taken: Taken) -> list[Source]:
    """Leave to each source what no better one of its device gives.

    Beats of an ECG are better than those of a pulse, and these than intervals that a device
    tells, which have no quality. The order of the sources does not matter. One that only says
    something of others, and has no features, is left as it is.

    Parameters
    ----------
    taken
        What is computed already; what is chosen is added.
    """
    chosen: list[Source] = []
    for source in sorted(sources, key=_rank):
        left = tuple(
            each
            for each in source.features
            if (source.identity, each.stream.data_name) not in taken
        )
        taken.update((source.identity, each.stream.data_name) for each in left)
        if left or not source.features:
            chosen.append(replace(source, features=left))
    return chosen


def _rank(source: Source) -> tuple[int, str, str]:
    kinds = [kind.value for kind in READ_TYPES]
    return kinds.index(source.header.content_type), source.header.data_name, source.source_id
