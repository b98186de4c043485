"""The clocks of other computers are measured by inlets that bring no data."""

from __future__ import annotations

import socket
import threading

import pylsl
import pytest

from biosensor_gateway.features import live as live_module
from biosensor_gateway.features.live import Live
from tests.features.test_sender_that_hangs import Noted
from tests.rigs.lsl_streams import note_askers, wait_until

pytestmark = pytest.mark.nightly


def test_an_inlet_of_data_is_never_asked_for_its_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would measure for the rest of its life, and grow: docs/liblsl-time-receiver.md."""
    monkeypatch.setattr(live_module, "SETTLED_S", 0.0)
    asked, pulled = note_askers(monkeypatch)
    info = pylsl.StreamInfo("pulse", "PPG", 1, 64.0, "float32", "pulse")
    channel = info.desc().append_child("channels").append_child("channel")
    channel.append_child_value("label", "green")
    channel.append_child_value("unit", "none")
    _outlet = pylsl.StreamOutlet(info)
    # Else its stamps need no correction.
    monkeypatch.setattr(socket, "gethostname", lambda: "another-computer")
    noted, stopping = Noted(), threading.Event()
    live = Live(noted)
    running = threading.Thread(target=live.run, args=[stopping])
    running.start()
    try:
        wait_until(lambda: noted.names == ["pulse"] and pulled and asked, "a measurement")
        (stage,) = live._stages.values()  # pyright: ignore[reportPrivateUsage]
        wait_until(lambda: (it := stage.connection) and it.correction is not None, "its result")
    finally:
        stopping.set()
        running.join()
    assert not {id(each) for each in asked} & {id(each) for each in pulled}
