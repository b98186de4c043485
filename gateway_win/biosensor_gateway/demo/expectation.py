"""Predicts which topics the demo fills in so many seconds, and why not the rest."""

from __future__ import annotations

from collections.abc import Container

from biosensor_common.spec import FromDevice, StreamSpec
from biosensor_gateway.demo.virtual_devices import virtual_class
from biosensor_gateway.devices.registry import declaration, sensor, sensor_names
from biosensor_gateway.simulation.virtual_device import Filled, VirtualDevice
from biosensor_gateway.streaming.room import Room

# From the first sample of any device until every other one is found and connected.
CONNECT_S = 9.0
_AT_ONCE = Filled(0, "")


def demo_devices() -> dict[str, str]:
    """Return the virtual device of each sensor that has one, as ``run --simulate`` names it."""
    having = {name: sensor(name) for name in sensor_names()}
    return {
        name: f"{name}:{each.demo}" if each.demo else name
        for name, each in having.items()
        if each.demo in each.virtual
    }


def first_devices() -> dict[str, str]:
    """Return those with which ``try`` begins, as `demo_devices` does all."""
    return {name: called for name, called in demo_devices().items() if sensor(name).introduces}


def fitting_devices(room: Room) -> tuple[dict[str, str], str]:
    """Return the devices whose streams fit into one process, and a sentence on the others."""
    devices = demo_devices()
    said = room.share_out({name: len(declaration(name).streams) for name in devices})
    return {name: called for name, called in devices.items() if room.has(name)}, said


def unfilled_streams(called: str, seconds: float) -> dict[str, str]:
    """Return by data name why a stream of a device is still empty so long after it connected."""
    filled = virtual_class(called).filled
    reasons = {name: _reason(each, seconds) for name, each in filled.items()}
    return {name: reason for name, reason in reasons.items() if reason}


def expected_topics(
    seconds: float | None, chunk_length: int, devices: Container[str] | None = None
) -> dict[str, str]:
    """Return by topic: empty text, or why it will have received nothing.

    Parameters
    ----------
    seconds
        Counted from the first sample of any device; None has no end.
    chunk_length
        Samples in a chunk.
    devices
        Sensors whose virtual devices run; None for all.
    """
    limit = float("inf") if seconds is None else seconds - CONNECT_S
    expected: dict[str, str] = {}
    for name, called in demo_devices().items():
        runs = devices is None or name in devices
        for topic, filled in _of_sensor(name, virtual_class(called), chunk_length).items():
            reason = _reason(filled, limit) if runs else "its device is left out"
            expected[f"/biosensors/{name}/{topic}"] = reason
    return expected


def _of_sensor(name: str, device: type[VirtualDevice], chunk_length: int) -> dict[str, Filled]:
    expected: dict[str, Filled] = {}
    for stream in declaration(name).streams:
        filled = device.filled.get(stream.data_name, _AT_ONCE)
        expected[stream.data_name] = filled
        if stream.chunk:
            expected[f"{stream.chunk}_chunk"] = _of_chunks(stream, device, filled, chunk_length)
    return expected


def _of_chunks(
    stream: StreamSpec, device: type[VirtualDevice], filled: Filled, chunk_length: int
) -> Filled:
    if filled.after_s is None:
        return filled
    said = device.rates_hz.get(stream.data_name)
    rate = said if isinstance(stream.rate, FromDevice) else stream.rate
    if not rate:
        return Filled(None, "its rate is not known")
    fill_s = chunk_length / rate
    return Filled(
        filled.after_s + fill_s, f"a chunk of {chunk_length} samples takes {fill_s:.1f} s"
    )


def _reason(filled: Filled, limit_s: float) -> str:
    if filled.after_s is None:
        return filled.reason
    return "" if filled.after_s <= limit_s else filled.reason
