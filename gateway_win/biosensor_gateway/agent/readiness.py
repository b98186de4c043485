"""Waits until all devices of the running agent deliver samples.

A connected device may be silent, and its state in the status may be outdated. So a device is ready
when the agent's counters of its streams advance. Only streams with a nominal rate are waited for;
irregular ones may have nothing to send. A device without such a stream is ready when its quality
stream advances, which such a device sends once a second.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from biosensor_common import naming
from biosensor_common.errors import ConfigError
from biosensor_common.quantities import ContentType
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.device_states import CONNECTED, identity_of
from biosensor_gateway.agent.status import DeclaredStream, declared_streams

FRESH_S = 5.0
"""A belt after a loss and an E4 send samples in lumps of seconds."""
_POLL_S = 0.25


@dataclass(frozen=True, slots=True)
class Missing:
    """A device, or an agent, that is not ready."""

    device: str  # Name of the device; empty if there is no agent.
    streams: tuple[str, ...]  # source_ids of the streams that are missing.
    why: str  # The reason, as far as it is known.

    @property
    def sentence(self) -> str:
        """The same as a sentence for people."""
        if not self.device:
            return self.why
        named = f" (no samples of {', '.join(self.streams)})" if self.streams else ""
        return f"{self.device}: {self.why}{named}"


@dataclass(frozen=True, slots=True)
class Readiness:
    """Outcome of waiting for an agent's devices."""

    ready: bool
    waited_s: float
    devices: int
    streams: int
    missing: tuple[Missing, ...]


@dataclass(slots=True)
class _Watch:
    """Notes when the counters of an agent's streams advance."""

    process: int = 0
    written: float = 0.0
    counts: dict[str, int] = field(default_factory=dict[str, int])
    advanced: dict[str, float] = field(default_factory=dict[str, float])

    def take(self, status: Mapping[str, Any]) -> None:
        if status["process"] != self.process:
            # Another agent was started, and counts from 0.
            self.process, self.counts, self.advanced = status["process"], {}, {}
        self.written = status["written"]
        for device in status["devices"]:
            for source, counters in device["streams"].items():
                count = counters["pushed"] + counters.get("waited", 0)
                if count > self.counts.get(source, count):
                    self.advanced[source] = self.written
                self.counts[source] = count

    def delivers(self, source: str) -> bool:
        return self.written - self.advanced.get(source, -FRESH_S) < FRESH_S


def wait_until_ready(folder: Path, timeout_s: float, without: Iterable[str] = ()) -> Readiness:
    """Wait until every enabled device of the running agent delivers on its steady streams.

    Parameters
    ----------
    folder
        The agent's state folder; the agent may still be starting.
    without
        Streams not to wait for, by source_id or data name.

    Returns
    -------
    Readiness
        With what is missing after the timeout.

    Raises
    ------
    SpecError
        If a sensor's declaration cannot be loaded.
    """
    begun, excluded, watch = time.monotonic(), frozenset(without), _Watch()
    while True:
        devices, streams, missing = _look(folder, watch, excluded)
        waited_s = time.monotonic() - begun
        if not missing or waited_s >= timeout_s:
            return Readiness(not missing, waited_s, devices, streams, missing)
        time.sleep(_POLL_S)


def _look(
    folder: Path, watch: _Watch, excluded: frozenset[str]
) -> tuple[int, int, tuple[Missing, ...]]:
    try:
        status = status_file.read_status(folder)
    except ConfigError as error:
        return 0, 0, (Missing("", (), str(error)),)
    watch.take(status)
    devices = status["devices"]
    if not devices:
        return 0, 0, (Missing("", (), "the agent has no enabled device, so there is no stream"),)
    awaited = [(device, steady_streams(device, excluded)) for device in devices]
    missing = (_missing(device, streams, watch) for device, streams in awaited)
    count = sum(len(streams) for _, streams in awaited)
    return len(devices), count, tuple(each for each in missing if each is not None)


def steady_streams(device: Mapping[str, Any], excluded: frozenset[str]) -> tuple[str, ...]:
    """Return the source_ids of the streams that show whether a device streams.

    Parameters
    ----------
    device
        A device of the agent's status. Before its first connection, its streams are those of the
        declaration.
    excluded
        source_ids and data names to leave out.
    """
    identity = identity_of(device)
    open_streams: Mapping[str, Mapping[str, Any]] = device["streams"]
    steady: list[str] = []
    quality: list[str] = []
    own = [DeclaredStream.model_validate(each) for each in device.get("declared", ())]
    for stream in declared_streams(identity.sensor, own):
        source = naming.source_id(identity, stream.data_name)
        if source in excluded or stream.data_name in excluded:
            continue
        # The rates that the device reported when it connected: some models lack a declared stream.
        opened = open_streams.get(source, {})
        rate = 0 if opened.get("silent") else opened.get("nominal_hz", stream.nominal_hz)
        if rate != 0 and not stream.is_text:
            steady.append(source)
        elif stream.content_type == ContentType.QUALITY:
            quality.append(source)
    return tuple(steady or quality)


def _missing(device: Mapping[str, Any], streams: tuple[str, ...], watch: _Watch) -> Missing | None:
    silent = tuple(source for source in streams if not watch.delivers(source))
    is_connected = device["state"] in CONNECTED
    if is_connected and not silent:
        return None
    parts = (device["participant"], device["sensor"], device["label"])
    name = " ".join(part for part in parts if part) + f" ({device['unit']})"
    if not is_connected:
        why = f"{device['state']} - {device['error']}" if device["error"] else device["state"]
        return Missing(name, streams if not device["streams"] else silent, why)
    if device.get("paused"):
        return Missing(name, silent, "paused; continue with: biosensor-gateway resume")
    why = device["error"] or "connected, but not all of its streams deliver samples"
    return Missing(name, silent, why)
