# pyright: reportPrivateUsage=false
"""The driver streams from virtual headbands, tidy or not, and finds them."""

from __future__ import annotations

import asyncio
import json
import random
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.captures.file import Event
from biosensor_gateway.captures.redaction import Redaction
from biosensor_gateway.devices.muse import LIGHT_LABELS
from biosensor_gateway.devices.muse.driver import (
    ATHENA_PRESETS,
    CLASSIC_PRESETS,
    DRIVER,
    MuseSettings,
    athena_preset,
    classic_preset,
    identify,
    model_of,
    recognise,
)
from biosensor_gateway.devices.muse.driver.emitter import ClassicEmitter
from biosensor_gateway.devices.muse.driver.protocol import (
    EEG,
    EEG_UV,
    FRAMES,
    PPG,
    Answers,
    Floats,
)
from biosensor_gateway.devices.muse.simulator import SimulatedAthena, SimulatedMuse
from biosensor_gateway.devices.muse.simulator.athena import DATA_UUIDS
from biosensor_gateway.devices.muse.simulator.classic import EEG_UUIDS
from biosensor_gateway.doctor.scan import drivers_by_precedence, recognised
from biosensor_gateway.simulation.faults import Fault, FaultKind, Untidiness
from biosensor_gateway.system.device_log import DeviceLog
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.nearby import Advertisement
from biosensor_gateway.transports.tap import What
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import Run, connected, streaming
from tests.rigs.emitter_sink import EmitterSink
from tests.rigs.gatt_host import GattHost, connection
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

if TYPE_CHECKING:
    from tests.muse.conftest import Make

# The driver streams from virtual headbands: all of it, once, at the right time.

SECONDS, SETTLED_S = 24.0, 8.0
PATIENCE_S = 15.0
CLASSIC = pytest.mark.parametrize("kind", [SimulatedMuse], ids=["classic"])
ATHENA = pytest.mark.parametrize("kind", [SimulatedAthena], ids=["athena"])


def assert_complete(run: Run, device: SimulatedMuse | SimulatedAthena, *names: str) -> None:
    """Assert that all samples came from the first one on, and that nothing was lost."""
    for name in names:
        places = assert_once_and_in_order(run.sink.rows[name], device.truth.samples(name).values)
        assert places == list(range(len(places))), name
    assert run.sink.dropped_bytes == 0


@CLASSIC
@ON_BUMBLE
async def test_a_movement_sensor_with_an_oscillator_of_its_own_is_followed(headband: Make) -> None:
    device = headband(motion_deviation=0.01, jitter_s=0.03)
    async with streaming(device) as run:
        await asyncio.sleep(2 * SECONDS)
    stamps = np.array(run.sink.times["acc"])
    errors = (stamps - device.truth.samples("acc").times[: len(stamps)])[len(stamps) // 2 :]
    assert np.abs(errors).max() < 0.02


@pytest.mark.parametrize(
    ("optics", "aux", "columns"), [(0, False, 0), (4, False, 4), (8, True, 8), (16, True, 16)]
)
@ATHENA
@ON_BUMBLE
async def test_light_has_the_channels_of_the_settings(
    headband: Make, optics: int, aux: bool, columns: int
) -> None:
    device = headband()
    async with streaming(device, optics=optics, aux=aux) as run:
        await until(run.sink.has(200, "eeg", *(["aux"] if aux else [])))
        await until(run.sink.has(60, "acc", *(["optics"] if optics else [])))
    assert_complete(run, device, "eeg", "acc", *(["optics"] if optics else []))
    filled = ~np.isnan(np.array(run.sink.rows["optics"] or [[]])).all(axis=0)
    assert filled.sum() == columns
    assert bool(run.sink.rows["aux"]) == aux
    if optics:
        empty = [LIGHT_LABELS[each] for each in np.flatnonzero(~filled)]
        assert run.sink.lacking["optics"] == empty


@CLASSIC
@ON_BUMBLE
async def test_what_is_switched_off_is_not_sent(headband: Make) -> None:
    device = headband()
    async with streaming(device, ppg=False) as run:
        await until(run.sink.has(200, "eeg"))
    assert not run.sink.rows["ppg"]
    async with connected(device, ppg=False) as info:
        assert (info.silent, info.refused) == ({"aux", "ppg", "optics"}, {"optics"})


async def test_it_is_known_by_what_it_says_of_itself(headband: Make) -> None:
    device = headband()
    is_athena = isinstance(device, SimulatedAthena)
    async with connected(device) as info:
        assert info.info.model == ("Muse S Athena" if is_athena else "Muse 2")
        assert info.info.serial_number == ("7001-FA20-0001" if is_athena else "4021-3A1F-0001")
        assert info.info.firmware_version == "1.2.13"
        assert info.silent == {"aux"} | info.refused
        assert info.refused == ({"ppg"} if is_athena else {"optics"})


@pytest.mark.parametrize(
    ("kind", "preset"),
    [(SimulatedMuse, "p1041"), (SimulatedAthena, "p50")],
    ids=["classic", "athena"],
)
@ON_BUMBLE
async def test_a_preset_of_another_model_is_said(headband: Make, preset: str) -> None:
    with pytest.raises(ProtocolError, match=f"no preset {preset}") as caught:
        async with connected(headband(), preset=preset):
            pass
    assert caught.value.reason is ProtocolReason.UNSUPPORTED


@CLASSIC
@ON_BUMBLE
async def test_a_preset_of_the_settings_is_taken(headband: Make) -> None:
    async with connected(headband(), preset="p20", aux=True) as info:
        assert info.silent == {"ppg", "optics"}


@ON_BUMBLE
async def test_who_refuses_everything_says_so(headband: Make) -> None:
    device = headband()
    device.apply(Fault(FaultKind.REFUSE, 3600.0))
    with pytest.raises(ProtocolError, match="refuses the command v") as caught:
        async with connected(device):
            pass
    assert caught.value.reason is ProtocolReason.REFUSED


@CLASSIC
@ON_BUMBLE
async def test_a_headband_of_an_unknown_generation_is_said(
    headband: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    has = BleLink.has

    def without_data(link: BleLink, uuid: str) -> bool:
        return uuid not in (*EEG, *FRAMES) and has(link, uuid)

    monkeypatch.setattr(BleLink, "has", without_data)
    with pytest.raises(ProtocolError, match="hold its button for 30 s") as caught:
        async with connected(headband()):
            pass
    assert caught.value.reason is ProtocolReason.UNSUPPORTED


@pytest.mark.parametrize("wanted", ["00:55:da:b0:77:01", ""])
@ON_BUMBLE
async def test_a_headband_without_a_name_is_found(headband: Make, wanted: str) -> None:
    device = headband(address="00:55:DA:B0:77:01")
    device.apply(Fault(Untidiness.NAMELESS, 3600.0))
    async with connected(device, device=wanted) as found:
        assert found.info.serial_number


@ON_BUMBLE
async def test_it_is_kept_alive(headband: Make) -> None:
    device = headband(patience_s=PATIENCE_S)
    async with streaming(device) as run:
        await asyncio.sleep(3 * PATIENCE_S)
        await run.goes_on(100, "eeg")
        assert run.supervisor.connections == 1


# Which advertisements are Muse headbands, and which preset each is told.
ADDRESS = "00:55:DA:B0:3A:1F"


def seen(name: str) -> Advertisement:
    service = frozenset({"0000fe8d-0000-1000-8000-00805f9b34fb"})
    return Advertisement(ADDRESS, name, -60, service)


@pytest.mark.parametrize("name", ["Muse-3A1F", "MuseS-3A1F", "Muse Athena-3A1F"])
def test_a_headband_is_found_with_the_settings_that_lead_to_it(name: str) -> None:
    found = recognised(drivers_by_precedence(), seen(name))
    assert found is not None
    assert (found.sensor, found.name) == ("muse", name)
    settings = MuseSettings.model_validate({"sensor": found.sensor, **found.settings})
    assert (settings.unit, settings.device) == ("3A1F", ADDRESS)
    assert identify(seen(name)) == "3A1F"


@pytest.mark.parametrize("name", ["Muse", "Museum-12", "My Muse-3A1F", "Polar H10 A1B2C3D4"])
def test_anything_else_is_none(name: str) -> None:
    assert recognise(seen(name)) is None


def test_a_headband_without_a_name_is_told_by_its_service() -> None:
    found = recognised(drivers_by_precedence(), seen(""))
    assert found is not None
    assert (found.sensor, found.settings) == ("muse", {"unit": "3A1F", "device": ADDRESS})
    assert recognise(Advertisement(ADDRESS)) is None


@pytest.mark.parametrize("serial", ["4021-3A1F-0001", "5031-3A1F-0001", "6002-3A1F-0001", ""])
@pytest.mark.parametrize("aux", [True, False])
@pytest.mark.parametrize("ppg", [True, False])
def test_the_preset_of_a_classic_has_what_is_wanted_and_no_more(
    serial: str, aux: bool, ppg: bool
) -> None:
    sent = CLASSIC_PRESETS[classic_preset(serial, aux=aux, ppg=ppg)]
    assert (sent.has_aux, sent.light > 0) == (aux, ppg)


@pytest.mark.parametrize(
    ("aux", "light", "preset"),
    [
        (False, 0, "p21"),
        (False, 4, "p1035"),
        (False, 8, "p1034"),
        (False, 16, "p1041"),
        (True, 0, "p1045"),
        (True, 8, "p1043"),
        (True, 16, "p1041"),
    ],
)
def test_the_preset_of_an_athena_is_the_smallest_that_has_what_is_wanted(
    aux: bool, light: int, preset: str
) -> None:
    assert athena_preset(aux=aux, light=light) == preset
    assert preset in ATHENA_PRESETS


def test_the_model_is_told_by_the_serial_number() -> None:
    models = [model_of(serial) for serial in ("4021-1", "5031-1", "7001-1", "9", "")]
    assert models == ["Muse 2", "Muse S", "Muse S Athena", "", ""]


REAL = json.loads((Path(__file__).parent / "vectors" / "real_control_pieces.json").read_text())
PACKET_BYTES = 20


def packet(piece: str) -> Event:
    """Return a packet of text, which begins with its length and is filled up."""
    data = bytes([len(piece)]) + piece.encode()
    return Event(t=0.0, link=0, what=What.CAME, data=data.ljust(PACKET_BYTES, b"\0").hex())


@pytest.mark.parametrize("known", [(), ("2031-TZRW-1324",)])
def test_a_headbands_numbers_are_replaced_across_packets(known: tuple[str, ...]) -> None:
    events = [packet(piece) for piece in REAL["pieces"]]
    told = Redaction(lambda _: False, DRIVER.identifiers).of(events, known)
    answers, before = Answers(), REAL["expected"]
    complete = filter(None, [answers.feed(event.bytes) for event in told])
    status = next(each for each in complete if "sn" in each)
    own = before[3]
    for key in ("sn", "ma", "id", "hn"):
        assert status[key] != own[key]
        assert len(str(status[key])) == len(own[key])
    # By the first character of its serial number the driver knows the model.
    assert str(status["sn"])[:1] == "2"
    assert {key: status[key] for key in ("bp", "ts", "ps", "rc")} == {
        key: own[key] for key in ("bp", "ts", "ps", "rc")
    }


# Electrodes whose packets are missing or late, and a battery that is more than full.
BEGIN_S = 1000.0
RATES = {"eeg": (EEG, 12, 256.0), "ppg": (PPG, 6, 64.0)}
Sent = tuple[float, str, bytes]


def packets(name: str, seconds: float = 60) -> Iterable[tuple[int, int, Sent]]:
    """Return packets with their number and channel; each value is its sample's number."""
    uuids, samples, rate_hz = RATES[name]
    for number in range(int(seconds * rate_hz / samples)):
        indices = range(number * samples, (number + 1) * samples)
        if name == "eeg":
            counts = [each % 4096 for each in indices]
            text = "".join(f"{each:03x}" for each in counts)
        else:
            text = "".join(f"{each:06x}" for each in indices)
        data = number.to_bytes(2, "big") + bytes.fromhex(text)
        for channel, uuid in enumerate(uuids):
            at_s = BEGIN_S + indices.stop / rate_hz + 0.001 * channel
            yield number, channel, (at_s, uuid, data)


def emitted(sent: Iterable[Sent]) -> EmitterSink:
    """Return what is emitted of packets."""
    sink = EmitterSink("muse")
    emitter = ClassicEmitter(sink, DeviceLog("test", sink.identity))
    emitter.started(has_aux=False)
    for at_s, uuid, data in sent:
        assert emitter.take(uuid, data, at_s)
    return sink


@pytest.mark.parametrize("name", ["eeg", "ppg"])
@pytest.mark.parametrize("times", [1, 3, 7])
def test_an_electrode_that_is_missing_some_times_doubles_no_rows(name: str, times: int) -> None:
    _, samples, _ = RATES[name]
    all_of = list(packets(name))
    last = len(RATES[name][0]) - 1
    missing = range(100, 100 + times)
    sink = emitted(each for n, channel, each in all_of if n not in missing or channel != last)
    rows = np.array(sink.emitted[name])
    count = len({n for n, _, _ in all_of}) * samples
    assert len(rows) == count
    assert not sink.losses.get(name)
    without = np.isnan(rows[:, last])
    # One more, where it came after nobody waited for it any longer.
    assert times * samples <= without.sum() <= (times + 1) * samples
    assert not np.isnan(rows[:, :last]).any()
    np.testing.assert_allclose(np.diff(sink.times[name]), 1 / RATES[name][2], rtol=0.02)


@pytest.mark.parametrize("name", ["eeg", "ppg"])
@pytest.mark.parametrize("of", [4, 7])
def test_a_channel_of_which_most_packets_are_missing_keeps_those_that_come(
    name: str, of: int
) -> None:
    _, samples, _ = RATES[name]
    last = len(RATES[name][0]) - 1
    all_of = list(packets(name))
    sink = emitted(each for n, channel, each in all_of if channel != last or n % of == 0)
    came = np.count_nonzero(~np.isnan(np.array(sink.emitted[name])[:, last]))
    assert came == pytest.approx(len({n for n, _, _ in all_of}) // of * samples, abs=samples)
    assert not sink.refusals.all


@pytest.mark.parametrize("seed", range(6))
def test_packets_that_are_lost_at_random_double_no_rows(seed: int) -> None:
    chance = random.Random(seed)
    came = [(n, each) for n, _, each in packets("eeg", 15) if chance.random() > 0.1 + seed / 25]
    sink = emitted(each for _, each in came)
    numbers = {n for n, _ in came}
    rows: Floats = np.array(sink.emitted["eeg"], np.float64)
    # The last one may still be waited for.
    assert len(rows) in (12 * len(numbers), 12 * len(numbers) - 12)
    values: Floats = np.nanmax(rows, axis=1)
    counts = np.round(values / EEG_UV) + 2048
    assert (np.diff(counts) > 0).all()
    assert sink.losses.get("eeg", 0) == counts[-1] - counts[0] + 1 - len(rows)
    errors_s = np.array(sink.times["eeg"]) - BEGIN_S - (counts + 1) / 256
    assert np.abs(errors_s).max() < 0.02


# The virtual headbands on the virtual radio, heard through plain bleak.


CONTROL = "273e0001-4c4d-454d-96be-f03bac821358"
DATA_1 = "273e0013-4c4d-454d-96be-f03bac821358"


async def tell(host: GattHost, command: str) -> None:
    data = bytes([len(command) + 1]) + command.encode() + b"\n"
    await host.client.write_gatt_char(CONTROL, data, response=False)


@ON_BUMBLE
@ATHENA
async def test_frames_of_an_athena_are_as_long_and_as_old_as_recorded_ones(headband: Make) -> None:
    headband()
    async with connection("MuseS-FA20") as host:
        await host.subscribe(CONTROL)
        await host.subscribe(DATA_1)
        await tell(host, "p1041")
        await tell(host, "dc001")
        await until(lambda: len(host.all(DATA_1)) >= 40)
        frames = host.all(DATA_1)[:40]
    assert all(frame[0] == len(frame) for frame in frames)
    assert {150 < len(frame) <= 240 for frame in frames} == {True}
    assert [struct.unpack_from("<H", frame, 1)[0] for frame in frames] == list(range(40))
    clocks_ms = np.array([int.from_bytes(frame[3:9], "little") for frame in frames])
    steps = np.diff(clocks_ms)
    assert clocks_ms[0] > 1.7e12
    assert steps.max() <= 130
    # As recorded, where 3 to 15 % of them turn back by up to 60 ms; here none does.
    assert steps.min() >= -60


LONGEST_BURST = 7


class Losing:
    """Lets notifications of a headband be lost on the way, several in a row."""

    def __init__(
        self, device: SimulatedMuse | SimulatedAthena, seed: int, patch: pytest.MonkeyPatch
    ) -> None:
        # All samples that it measured, with their times, by data name.
        self.measured: dict[str, list[tuple[float, Floats]]] = {}
        self.is_losing = False
        self._draw = random.Random(seed)
        self._left: dict[str, int] = {}
        notify, note = device._notify, device._note
        # Of a classic one electrode; an Athena sends all that it measures together.
        losing = DATA_UUIDS if isinstance(device, SimulatedAthena) else (EEG_UUIDS["TP10"],)

        async def losing_notify(uuid: str, value: bytes) -> bool:
            if self.is_losing and uuid in losing and self._is_lost(uuid):
                return False
            return await notify(uuid, value)

        def noting(name: str, times: Iterable[float], rows: Iterable[Any], *, sent: bool) -> None:
            stamps, values = list(times), [np.atleast_1d(row) for row in rows]
            self.measured.setdefault(name, []).extend(zip(stamps, values, strict=True))
            note(name, stamps, values, sent=sent)

        patch.setattr(device, "_notify", losing_notify)
        patch.setattr(device, "_note", noting)

    def _is_lost(self, uuid: str) -> bool:
        left = self._left.get(uuid, 0)
        if not left and self._draw.random() < 0.04:
            left = self._draw.randint(1, LONGEST_BURST)
        self._left[uuid] = max(0, left - 1)
        return left > 0


@pytest.mark.parametrize("seed", range(3))
async def test_what_is_lost_several_times_running_moves_nothing_and_is_counted(
    headband: Make, seed: int, rig: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A busy computer keeps real packets waiting.
    limit_s = 0.06 if rig == "bumble" else 0.5
    device = headband(jitter_s=0.02, drift_ppm=80.0)
    losing = Losing(device, seed, monkeypatch)
    # With all that it has, and answers that are joined and cut anywhere.
    device.apply(Fault(Untidiness.GLUED, 1000.0))
    is_athena = isinstance(device, SimulatedAthena)
    wanted = {"aux": True, "optics": 16} if is_athena else {}
    names = ["eeg", "acc", "gyro", *(["aux", "optics"] if is_athena else ["ppg"])]
    async with streaming(device, **wanted) as run:
        await until(run.sink.has(100, *names))
        await asyncio.sleep(SETTLED_S)
        begin_s, losing.is_losing = run.sink.clock(), True
        await asyncio.sleep(SECONDS)
        losing.is_losing = False
        await asyncio.sleep(2.0)
        assert run.supervisor.connections == 1
    lost = 0
    for name in names:
        times = np.array([time for time, _ in losing.measured[name]])
        rows: Floats = np.array([row for _, row in losing.measured[name]])
        places: list[int] = []
        for stamp, row in zip(run.sink.times[name], run.sink.array(name), strict=True):
            begin, end = np.searchsorted(times, [stamp - limit_s, stamp + limit_s]).tolist()
            came = ~np.isnan(row)
            same = np.isclose(rows[begin:end, came], row[came], rtol=1e-5).all(axis=1)
            later = [begin + int(each) for each in np.flatnonzero(same)]
            found = [each for each in later if not places or each > places[-1]]
            assert found or stamp < begin_s - SETTLED_S / 2, f"{name}: {row} at {stamp}"
            if found:
                places.append(min(found, key=lambda place: abs(times[place] - stamp)))
        missing = places[-1] - places[0] + 1 - len(places)
        assert run.sink.lost_count(name) == missing, name
        lost += missing
    assert lost > 0 or not is_athena
