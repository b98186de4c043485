"""Senders of other programs that push in bursts, or end before they are received."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import psutil
import pylsl
import pytest

from biosensor_gateway.features import live as live_module
from biosensor_gateway.features.live import Live
from biosensor_gateway.features.sources import Source
from tests.features import signals
from tests.features.signals import Array
from tests.rigs.polling import wait_until
from tests.rigs.terminal import HeldConsole

# Live heart rates of other programs that push many samples at once, by the real program.

LASTS_S, DEADLINE_S = 45.0, 60.0
BURST = 73
"""As a Polar H10 sends its ECG: 73 samples each 0.56 s."""
FEWEST_BEATS = 15
"""Some seconds pass until the program knows how a stream is stamped."""


class Sender:
    """Sends a heart in bursts of `BURST` samples; `truth` are its beats, by LSL's clock."""

    def __init__(self, kind: str, rate: float, bpm: float, *, overlaps: bool) -> None:
        self.name, self._rate, self._overlaps = f"stranger_{kind.lower()}", rate, overlaps
        beats = signals.regular(bpm, LASTS_S)
        make = signals.ecg_of if kind == "ECG" else signals.pulse_of
        self._signal = make(beats, rate, LASTS_S)
        info = pylsl.StreamInfo(self.name, kind, 1, rate, "float32", f"{self.name}-id")
        self._outlet = pylsl.StreamOutlet(info)
        self._begin_s = pylsl.local_clock()
        self.truth = self._begin_s + beats

    def send(self, until: threading.Event) -> None:
        """Send each packet when its last sample was measured, and a bit later."""
        late = np.random.default_rng(2).exponential(0.03, len(self._signal) // BURST)
        for number, late_s in enumerate(late):
            due_s = self._begin_s + (number + 1) * BURST / self._rate + late_s
            if until.wait(max(0.0, due_s - pylsl.local_clock())):
                return
            rows = self._signal[number * BURST : (number + 1) * BURST, np.newaxis]
            now_s = pylsl.local_clock()
            if self._overlaps:
                self._outlet.push_chunk(rows.astype(np.float32), now_s)
                continue
            for row in rows.tolist():
                self._outlet.push_sample(row, now_s)


@contextmanager
def sending(*senders: Sender) -> Generator[None]:
    ended = threading.Event()
    threads = [threading.Thread(target=each.send, args=(ended,)) for each in senders]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        for thread in threads:
            thread.join()


@contextmanager
def features_program(said: Path) -> Generator[None]:
    command = [sys.executable, "-m", "biosensor_gateway.cli", "features"]
    with said.open("wb") as output, subprocess.Popen(command, stdout=output, stderr=output) as it:
        try:
            yield
        finally:
            it.kill()


def _inlet(of: Sender, data_name: str) -> pylsl.StreamInlet:
    end = time.monotonic() + DEADLINE_S
    while time.monotonic() < end:
        for info in pylsl.resolve_streams(1.0):
            if of.name in info.name() and info.name().endswith(f"-{data_name}"):
                return pylsl.StreamInlet(info)
    raise AssertionError(f"there is no {data_name} of {of.name}")


def _all_of(inlet: pylsl.StreamInlet) -> tuple[Array, Array]:
    values, stamps = inlet.pull_chunk(timeout=0.5, max_samples=1000)
    return np.array(stamps), np.array(values)


@pytest.mark.seam
def test_a_stranger_that_sends_in_bursts_has_its_heart_rate(tmp_path: Path) -> None:
    with ExitStack() as stack:
        stack.enter_context(features_program(tmp_path / "said.txt"))
        senders = [
            Sender("ECG", 130.0, 72.0, overlaps=False),
            Sender("PPG", 130.0, 95.0, overlaps=True),
        ]
        stack.enter_context(sending(*senders))
        inlets = [(_inlet(each, "beats"), _inlet(each, "hr_live")) for each in senders]
        for pair in inlets:
            for inlet in pair:
                inlet.open_stream(DEADLINE_S)
        time.sleep(max(0.0, senders[0].truth[-1] - pylsl.local_clock()))
        for sender, (beats, rates) in zip(senders, inlets, strict=True):
            stamps, _ = _all_of(beats)
            assert len(stamps) >= FEWEST_BEATS
            truth = sender.truth[
                (sender.truth > stamps[0] - 0.3) & (sender.truth < stamps[-1] + 0.3)
            ]
            assert len(stamps) == pytest.approx(len(truth), abs=2)
            told_s, told = _all_of(rates)
            mean = 60.0 / np.diff(truth).mean()
            assert len(told_s)
            assert np.abs(told[:, 0] - mean).max() < 5.0


# A stream that ends before it is received holds up no other one, nor the end of the program.
GONE_DEADLINE_S = 60.0
LIVES_S = 1.5
"""Its header is read by then, and it is not received yet: devices settle for 3 s."""


def _outlet(name: str) -> pylsl.StreamOutlet:
    info = pylsl.StreamInfo(name, "PPG", 1, 64.0, "float32", name)
    channel = info.desc().append_child("channels").append_child("channel")
    channel.append_child_value("label", "green")
    channel.append_child_value("unit", "none")
    return pylsl.StreamOutlet(info)


@contextmanager
def _features(said: Path) -> Generator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-m", "biosensor_gateway.cli", "features"]
    with said.open("wb") as output, subprocess.Popen(command, stdout=output, stderr=output) as it:
        try:
            yield it
        finally:
            it.kill()


def _wait_for(said: Path, text: str) -> None:
    end = time.monotonic() + GONE_DEADLINE_S
    while text not in said.read_text("utf-8"):
        assert time.monotonic() < end, f"{text!r} was never said: {said.read_text('utf-8')}"
        time.sleep(0.05)


@pytest.mark.seam
@pytest.mark.skipif(sys.platform == "win32", reason="ends a process by a signal")
def test_others_go_on_and_a_signal_ends_it(tmp_path: Path) -> None:
    said = tmp_path / "said.txt"
    with _features(said) as program:
        _wait_for(said, "looking for raw streams")
        stays = _outlet("first")
        _wait_for(said, "first: ")
        for count in range(2):
            goes = _outlet(f"goes-{count}")
            time.sleep(LIVES_S)
            del goes
        later = _outlet("later")
        _wait_for(said, "later: ")
        comes_back = _outlet("goes-1")
        _wait_for(said, "goes-1: ")
        program.send_signal(signal.SIGTERM)
        assert program.wait(GONE_DEADLINE_S) == 0
        del stays, later, comes_back


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="holds a pseudo-terminal")
def test_a_terminal_that_is_held_holds_up_neither_features_nor_the_end() -> None:
    command = [sys.executable, "-m", "biosensor_gateway.cli", "features"]
    held = HeldConsole(is_stopped=True)
    with held.program(command, os.environ) as program:
        sender = Sender("ECG", 130.0, 72.0, overlaps=False)
        with sending(sender):
            rates = _inlet(sender, "hr_live")
            rates.open_stream(DEADLINE_S)
            wait_until(lambda: len(_all_of(rates)[0]), "a heart rate")
        program.send_signal(signal.SIGTERM)
        assert program.wait(GONE_DEADLINE_S) == 0


SENDER = """
import sys, time
import pylsl
info = pylsl.StreamInfo("held", "ECG", 1, 130.0, "float32", "held")
outlet = pylsl.StreamOutlet(info)
print("up", flush=True)
time.sleep(600)
"""


class Noted:
    def __init__(self) -> None:
        self.names: list[str] = []

    def found(self, source: Source) -> None:
        self.names.append(source.name)

    def refused(self, sentence: str) -> None:
        raise AssertionError(sentence)


@pytest.mark.skipif(sys.platform == "win32", reason="stops a process by a signal")
@pytest.mark.seam
def test_another_stream_is_taken_while_one_does_not_say_what_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(live_module, "SETTLED_S", 0.0)
    # Longer than the test: who waits for it fails.
    monkeypatch.setattr(live_module, "_DESCRIPTION_S", 3 * DEADLINE_S)
    info = pylsl.StreamInfo("own", "ECG", 1, 130.0, "float32", "own")
    channel = info.desc().append_child("channels").append_child("channel")
    channel.append_child_value("label", "ECG")
    channel.append_child_value("unit", "microvolts")
    outlet = pylsl.StreamOutlet(info)
    with subprocess.Popen([sys.executable, "-c", SENDER], stdout=subprocess.PIPE) as sender:
        try:
            assert sender.stdout is not None
            assert sender.stdout.readline() == b"up\n"
            both = [*_resolved("held"), *_resolved("own")]
            os.kill(sender.pid, signal.SIGSTOP)
            # One of its threads may still be at work, and answer.
            while psutil.Process(sender.pid).status() != psutil.STATUS_STOPPED:
                time.sleep(0.01)
            noted = Noted()
            live = Live(noted)
            end = time.monotonic() + DEADLINE_S
            while not noted.names:
                live.look(both)
                live.read()
                assert time.monotonic() < end, "the other one was waited for"
                time.sleep(0.05)
        finally:
            sender.kill()
    assert noted.names == ["own"]
    del outlet


def _resolved(source_id: str) -> list[pylsl.StreamInfo]:
    found = pylsl.resolve_byprop("source_id", source_id, 1, DEADLINE_S)
    assert found, source_id
    return found[:1]
