"""Which outlet of a stream is received: in one session, one at a time, with one header."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any, cast

import pylsl
import pytest
from pylsl import util

from biosensor_common import naming
from biosensor_common.lsl import inlet as inlet_module
from biosensor_common.lsl.inlet import read_description
from biosensor_common.lsl_header import append_children, describe
from biosensor_common.quantities import ContentType, Unit
from biosensor_common.spec import DeviceIdentity, DeviceInfo, StreamSpec
from biosensor_common.table import channels, raw
from biosensor_gateway.devices.muse import SPEC as MUSE
from biosensor_gateway.features import live as live_module
from biosensor_gateway.features.live import DUPLICATE_S, SETTLED_S, SILENT_S, Live
from biosensor_gateway.features.sources import Source

FIRST, SECOND = "uid-1", "uid-2"


class Outlet:
    """Announces a stream, as a resolver's info does, and is what its inlet receives."""

    def __init__(
        self,
        uid: str,
        source_id: str = "strap",
        unit: str = "microvolts",
        kind: str = "ECG",
    ) -> None:
        self._uid, self._source_id = uid, source_id
        info = pylsl.StreamInfo("strap", kind, 1, 130.0, "float32", source_id)
        channel = info.desc().append_child("channels").append_child("channel")
        channel.append_child_value("label", "ECG")
        channel.append_child_value("unit", unit)
        self.xml = info.as_xml()
        self.is_gone = self.sends = False
        self._count, self._row = 0, [1.0]
        self.openings = self.closings = 0

    def uid(self) -> str:
        return self._uid

    def source_id(self) -> str:
        return self._source_id

    def name(self) -> str:
        return "strap"

    def hostname(self) -> str:
        return "elsewhere"

    def pull_chunk(self, _timeout: float, _most: int) -> tuple[list[Any], list[float]]:
        if self.is_gone:
            raise util.LostError
        if not self.sends:
            return [], []
        self._count += 1
        return [self._row], [self._count / 130]

    def time_correction(self, _timeout: float) -> float:
        return 0.0

    def close_stream(self) -> None:
        self.closings += 1


class Own(Outlet):
    """One of ours, all of one device."""

    WATCH = DeviceIdentity("watch", "")

    def __init__(self, uid: str, stream: StreamSpec) -> None:
        super().__init__(uid, naming.source_id(self.WATCH, stream.data_name))
        self._row = [1.0] * len(stream.channels)
        assert isinstance(stream.rate, float | int)
        info = pylsl.StreamInfo(
            naming.lsl_name(self.WATCH, stream.data_name),
            stream.content_type.value,
            len(stream.channels),
            stream.rate,
            stream.format.value,
            self.source_id(),
        )
        append_children(info.desc(), describe(stream, self.WATCH, DeviceInfo(model="any")))
        self.xml = info.as_xml()


class Immediate:
    """Runs what it is given at once."""

    def submit(self, work: Callable[..., Any], *arguments: Any, **options: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(work(*arguments, **options))
        except RuntimeError as error:
            future.set_exception(error)
        return future


class Told:
    def __init__(self) -> None:
        self.sources: list[Source] = []
        self.sentences: list[str] = []

    def found(self, source: Source) -> None:
        self.sources.append(source)

    def refused(self, sentence: str) -> None:
        self.sentences.append(sentence)

    def with_beats(self) -> list[str]:
        """The source_ids of the streams of which beats were computed."""
        return [
            each.source_id
            for each in self.sources
            if "beats" in {feature.stream.data_name for feature in each.features}
        ]


class Watched:
    """Features of streams that a test announces."""

    def __init__(self) -> None:
        self.told, self.now = Told(), 0.0
        self.live = Live(self.told, lambda: self.now)
        self.live._asking = Immediate()  # type: ignore[assignment]

    def see(self, *outlets: Outlet, seconds: float = 2 * SETTLED_S) -> None:
        """Have these announced for so long."""
        for _ in range(3):
            self.now += seconds / 3
            self.live.look(cast("Sequence[pylsl.StreamInfo]", outlets))
            self.live.read()


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Watched:
    def opened(info: Any, _limit_s: float, _buffer_s: int, *, as_numpy: bool) -> Any:
        assert not as_numpy
        info.openings += 1
        if info.is_gone:
            raise util.TimeoutError
        return info

    monkeypatch.setattr(inlet_module, "open_inlet", opened)

    def described(info: Outlet) -> str:
        return info.xml

    def sender(_source: Source) -> object:
        return object()

    monkeypatch.setattr(live_module, "_description", described)
    monkeypatch.setattr(live_module, "Sender", sender)
    return Watched()


def test_a_stream_that_comes_back_is_gone_on_with(watched: Watched) -> None:
    first, second = Outlet(FIRST), Outlet(SECOND)
    watched.see(first)
    first.is_gone = True
    watched.see(first)
    watched.see(second)
    assert len(watched.told.sources) == 1
    assert (second.openings, second.closings) == (1, 0)


def test_the_same_outlet_is_opened_again_when_its_connection_is_lost(watched: Watched) -> None:
    outlet = Outlet(FIRST)
    watched.see(outlet)
    outlet.is_gone = True
    watched.live.read()
    outlet.is_gone = False
    watched.see(outlet)
    assert outlet.openings == 2
    assert len(watched.told.sources) == 1


def test_another_header_is_another_source(watched: Watched) -> None:
    first, second = Outlet(FIRST), Outlet(SECOND, unit="millivolts")
    watched.see(first)
    watched.see(second)
    assert [each.header.units for each in watched.told.sources] == [
        ("microvolts",),
        ("millivolts",),
    ]
    assert first.closings == 1


def test_of_two_that_live_the_first_stays_and_it_is_said_once(watched: Watched) -> None:
    first, second = Outlet(FIRST), Outlet(SECOND)
    watched.see(first)
    watched.see(first, second, seconds=DUPLICATE_S / 2)
    assert watched.told.sentences == []
    watched.see(first, second, seconds=3 * DUPLICATE_S)
    watched.see(first, second, seconds=3 * DUPLICATE_S)
    (sentence,) = watched.told.sentences
    assert "share the source_id 'strap'" in sentence
    assert second.openings == 0


def test_what_cannot_be_opened_holds_up_no_other_stream(watched: Watched) -> None:
    gone, other = Outlet(FIRST), Outlet(SECOND, source_id="other")
    gone.is_gone = True
    watched.see(gone, other)
    assert [each.source_id for each in watched.told.sources] == ["other"]
    gone.is_gone = False
    watched.see(gone, other)
    watched.see(gone, other)
    assert [each.source_id for each in watched.told.sources] == ["other", "strap"]


def test_what_a_stream_leaves_is_computed_of_another_one_of_its_device(watched: Watched) -> None:
    ecg, pulse = Outlet(FIRST, "ecg"), Outlet(SECOND, "ppg", kind="PPG")
    ecg.is_gone = True
    watched.see(ecg, pulse)
    watched.see(pulse)
    assert {each.source_id for each in watched.told.sources} == {"ppg"}
    data_names = {each.stream.data_name for each in watched.told.sources[-1].features}
    assert {"beats", "hr_live"} <= data_names


ECG = raw("ecg", ContentType.ECG, channels(Unit.MICROVOLTS, "ecg"), 130)
PPG = raw("ppg", ContentType.PPG, channels(Unit.COUNTS, "green"), 64)


@pytest.mark.parametrize(
    ("sends_not", "sends"),
    [
        (ECG, PPG),
        (MUSE.stream("optics"), MUSE.stream("ppg")),
        (MUSE.stream("ppg"), MUSE.stream("optics")),
    ],
    ids=lambda stream: stream.data_name,
)
def test_what_a_stream_never_sends_is_computed_of_another_one_of_its_device(
    watched: Watched, sends_not: StreamSpec, sends: StreamSpec
) -> None:
    """A Muse 2 has no optics, an Athena no PPG, and each announces both."""
    silent, pulse = Own(FIRST, sends_not), Own(SECOND, sends)
    # Before the device sends anything, nobody knows which of them will.
    for _ in range(3):
        watched.see(silent, pulse, seconds=SILENT_S)
    assert watched.told.with_beats() == []
    pulse.sends = True
    for _ in range(3):
        watched.see(silent, pulse, seconds=SILENT_S)
    assert watched.told.with_beats() == [pulse.source_id()]
    silent.sends = True
    watched.see(silent, pulse, seconds=SILENT_S)
    assert watched.told.with_beats() == [pulse.source_id()]


def test_an_outlet_that_has_the_port_of_another_does_not_describe_it() -> None:
    class Inlet:
        def info(self, _limit_s: float) -> Outlet:
            return Outlet(SECOND)

    inlet = cast("pylsl.StreamInlet", Inlet())
    with pytest.raises(util.LostError):
        read_description(inlet, FIRST, 1.0)
    assert read_description(inlet, SECOND, 1.0).uid() == SECOND
