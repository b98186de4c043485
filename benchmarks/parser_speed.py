"""How fast the BioHarness decoder is, on bytes of a real device."""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass
from importlib.resources import files
from itertools import pairwise

from biosensor_gateway.devices.zephyr.driver.messages import Waveform
from biosensor_gateway.devices.zephyr.driver.protocol import MessageId, ZephyrProtocol
from biosensor_gateway.devices.zephyr.simulator.recorded_bioharness import (
    RECORDING_150_S,
    RECORDING_WITH_GAP,
    read_timing,
)

# Typical read of a Bluetooth serial port, for the recording that has no timing.
_PIECE_SIZE = 125


@dataclass(frozen=True, slots=True)
class ParserSpeed:
    """Speed on one recording, as multiples of real time."""

    recording: str
    recorded_s: float  # Time that the recording's ECG covers; a gap does not count.
    best: float
    median: float


def measure(passes: int) -> list[ParserSpeed]:
    """Decode each recording *passes* times."""
    return [_measure(name, passes) for name in (RECORDING_150_S, RECORDING_WITH_GAP)]


def _measure(recording: str, passes: int) -> ParserSpeed:
    pieces = _pieces(recording)
    recorded_s = _ecg_s(pieces)
    multiples = [recorded_s / _pass_s(pieces) for _ in range(passes)]
    return ParserSpeed(recording, recorded_s, max(multiples), statistics.median(multiples))


def _pieces(recording: str) -> list[bytes]:
    """Cut a recording as it was read, or into equal pieces where that is not known."""
    folder = files("biosensor_gateway").joinpath("devices/zephyr/simulator/recordings")
    data = folder.joinpath(f"{recording}.dat").read_bytes()
    timing = folder.joinpath(f"{recording}-timing.csv")
    ends = [0, *range(_PIECE_SIZE, len(data), _PIECE_SIZE), len(data)]
    if timing.is_file():
        reads = read_timing(timing.read_text("ascii"))
        ends = [0, *(read.total_bytes for read in reads), len(data)]
    return [data[start:end] for start, end in pairwise(ends) if end > start]


def _ecg_s(pieces: list[bytes]) -> float:
    protocol = ZephyrProtocol()
    return sum(
        len(message.samples) * message.period_s
        for piece in pieces
        for message in protocol.feed(piece)
        if isinstance(message, Waveform) and message.message_id == MessageId.ECG
    )


def _pass_s(pieces: list[bytes]) -> float:
    protocol = ZephyrProtocol()
    begin = time.perf_counter()
    for piece in pieces:
        protocol.feed(piece)
    return time.perf_counter() - begin
