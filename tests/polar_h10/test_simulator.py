"""The virtual Polar H10 on the virtual radio, heard through plain bleak."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import NamedTuple

import numpy as np
import pytest
from bleak.exc import BleakGATTProtocolError
from numpy.typing import NDArray
from pylsl import local_clock

from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.devices.polar_h10.simulator.pmd import Measurement
from biosensor_gateway.devices.polar_h10.simulator.products import H10, VERITY_SENSE, Product
from biosensor_gateway.devices.polar_h10.simulator.quirks import Firmware, Quirks
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World
from tests.rigs.gatt_host import GattHost, advertised, connection
from tests.rigs.polling import until

HEART_RATE = "2a37"
PMD_SERVICE = "fb005c80-02e7-f387-1cad-8acd2d8df0c8"
CONTROL = "fb005c81-02e7-f387-1cad-8acd2d8df0c8"
DATA = "fb005c82-02e7-f387-1cad-8acd2d8df0c8"
NAME, SENSE = "Polar H10 A1B2C3D4", "Polar Sense A1B2C3D4"
START_ECG = "020000018200 01010e00"
START_ACC = "02020201080000 01c80001011000"
POWER_ON_NS = 599_616_000_000_000_000
MakeRadio = Callable[..., Radio]
MakeH10 = Callable[..., SimulatedPolarH10]


@pytest.fixture
def make_radio() -> Iterator[MakeRadio]:
    with ExitStack() as stack:
        world = stack.enter_context(World())

        def make(host_mtu: int = 517) -> Radio:
            radio = Radio(world, host_mtu=host_mtu)
            stack.enter_context(virtual_bluetooth(radio))
            return radio

        yield make


@pytest.fixture
def make_h10(make_radio: MakeRadio) -> Iterator[MakeH10]:
    with ExitStack() as stack:

        def make(
            quirks: Quirks | None = None,
            *,
            host_mtu: int = 517,
            product: Product = H10,
            wearer: Wearer | None = None,
            drift_ppm: float = 0.0,
            jitter_s: float = 0.0,
        ) -> SimulatedPolarH10:
            radio = make_radio(host_mtu)
            made = SimulatedPolarH10(
                radio.world,
                radio,
                quirks=quirks,
                product=product,
                wearer=wearer,
                drift_ppm=drift_ppm,
                jitter_s=jitter_s,
            )
            return stack.enter_context(made)

        yield make


@pytest.fixture
def h10(make_h10: MakeH10) -> SimulatedPolarH10:
    return make_h10()


class Frame(NamedTuple):
    """One frame as this file's own small decoder sees it."""

    kind: int
    stamp_ns: int
    layout: int
    body: bytes


def frames_of(host: GattHost, kind: int) -> list[Frame]:
    found = [
        Frame(data[0], int.from_bytes(data[1:9], "little"), data[9], data[10:])
        for data in host.all(DATA)
    ]
    return [frame for frame in found if frame.kind == kind]


def int24(body: bytes) -> list[int]:
    return [
        int.from_bytes(body[at : at + 3], "little", signed=True) for at in range(0, len(body), 3)
    ]


def int16(body: bytes) -> NDArray[np.int16]:
    return np.frombuffer(body, "<i2").reshape(-1, 3)


async def open_pmd(host: GattHost) -> None:
    await host.subscribe(CONTROL, DATA)


async def test_it_is_advertised_as_an_h10_is(h10: SimulatedPolarH10) -> None:
    device, data = await advertised(NAME)
    assert device.address == "A0:9E:1A:A1:B2:C3"
    assert h10.settings == {"device": "A1B2C3D4"}
    assert {uuid[4:8] for uuid in data.service_uuids} == {"180d", "feee"}
    assert data.rssi == -58
    payload = data.manufacturer_data[0x006B]
    assert len(payload) == 4
    assert payload[0] & 0b11 == 0b10


async def test_its_advertisement_shows_that_it_is_alive(h10: SimulatedPolarH10) -> None:
    del h10
    counters: set[int] = set()
    rates: set[int] = set()
    while len(counters) < 4:
        payload = (await advertised(NAME))[1].manufacturer_data[0x006B]
        counters.add(payload[0] >> 2 & 7)
        rates.add(payload[3])
    assert max(rates) > 60


async def test_it_says_what_it_is(h10: SimulatedPolarH10) -> None:
    async with connection(NAME) as host:
        read = host.client.read_gatt_char
        texts = [bytes(await read(uuid)) for uuid in ("2a29", "2a24", "2a25")]
        assert texts == [b"Polar Electro Oy\0", b"H10\0", b"A1B2C3D4\0"]
        assert bytes(await read("2a38")) == b"\1"
        assert bytes(await read("2a19")) == b"\x57"
        assert bytes(await read(CONTROL)).hex() == "0f05" + 15 * "00"
    assert h10.truth.samples("rssi").values.tolist() == [[-58.0]]


async def test_heart_rate_carries_intervals_and_nothing_about_contact(make_h10: MakeH10) -> None:
    h10 = make_h10(wearer=Wearer(heart_rate_bpm=140.0))
    async with connection(NAME) as host:
        await host.subscribe(HEART_RATE)
        values = await host.more(HEART_RATE, 4, 0)
    assert {data[0] for data in values} == {0x10}
    rates = [float(data[1]) for data in values if data[1]]
    intervals = [rr / 1024 for data in values for rr in np.frombuffer(data[2:], "<u2").tolist()]
    assert len(intervals) >= 5
    assert h10.truth.samples("hr").values[: len(rates), 0].tolist() == rates
    assert h10.truth.samples("ibi").values[: len(intervals), 0].tolist() == intervals


async def test_the_handshake_is_as_published(h10: SimulatedPolarH10) -> None:
    async with connection(NAME) as host:
        with pytest.raises(BleakGATTProtocolError) as refused:
            await host.client.write_gatt_char(CONTROL, b"\1\0", response=True)
        assert refused.value.code == 0xFD
        await open_pmd(host)
        assert await host.ask(CONTROL, "0100") == "f0010000000001820001010e00"
        assert await host.ask(CONTROL, "0102") == (
            "f0010200000004190032006400c800010110000203020004000800"
        )
        assert await host.ask(CONTROL, START_ECG) == "f002000000"
        assert await host.ask(CONTROL, START_ACC) == "f00202000001"
        assert await host.ask(CONTROL, START_ECG) == "f002000600"
        await until(lambda: frames_of(host, 0) and frames_of(host, 2))
        assert await host.ask(CONTROL, "0300") == "f003000000"
        assert await host.ask(CONTROL, "0302") == "f003020000"
        assert await host.ask(CONTROL, "0209") == "f002090300"
        assert len(host.all(CONTROL)) == 8
    assert {"ecg", "acc"} <= set(h10.truth.data_names)


async def test_ecg_frames_are_the_truth(make_h10: MakeH10) -> None:
    h10 = make_h10(drift_ppm=150.0, jitter_s=0.02)
    async with connection(NAME) as host:
        await open_pmd(host)
        await host.ask(CONTROL, START_ECG)
        await until(lambda: len(frames_of(host, 0)) >= 5)
        frames, heard = frames_of(host, 0)[:5], host.heard[DATA][:5]
    truth = h10.truth.samples("ecg")
    assert [(frame.layout, len(frame.body)) for frame in frames] == 5 * [(0, 219)]
    values = [uv for frame in frames for uv in int24(frame.body)]
    assert truth.values[: len(values), 0].tolist() == values
    assert max(values) > 800
    # The device's clock against the true one: 150 ppm fast, 1/130 s a sample.
    last_s = truth.times[72 : 73 * 5 : 73]
    stamps_s = [(frame.stamp_ns - POWER_ON_NS) / 1e9 for frame in frames]
    assert 0 < stamps_s[0] < 60
    np.testing.assert_allclose(np.diff(stamps_s), 73 / 130, atol=1e-8)
    np.testing.assert_allclose(np.diff(last_s), 73 / 130 / (1 + 150e-6), atol=1e-7)
    assert all(one.arrival >= time for one, time in zip(heard, last_s, strict=True))


async def test_acceleration_frames_are_the_truth(h10: SimulatedPolarH10) -> None:
    async with connection(NAME) as host:
        await open_pmd(host)
        await host.ask(CONTROL, START_ACC)
        await until(lambda: len(frames_of(host, 2)) >= 6)
        frames = frames_of(host, 2)[:6]
    assert [(frame.layout, len(frame.body)) for frame in frames] == 6 * [(1, 216)]
    values = np.concatenate([int16(frame.body) for frame in frames])
    truth = h10.truth.samples("acc")
    np.testing.assert_allclose(truth.values[: len(values)], values / 1000, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(values, axis=1), 1000, atol=60)
    np.testing.assert_allclose(np.diff(truth.times), 1 / 200, atol=1e-9)


async def test_the_ecg_beats_where_the_intervals_end(make_h10: MakeH10) -> None:
    h10 = make_h10(wearer=Wearer(heart_rate_bpm=120.0))
    async with connection(NAME) as host:
        await open_pmd(host)
        await host.subscribe(HEART_RATE)
        await host.ask(CONTROL, START_ECG)
        await until(lambda: len(frames_of(host, 0)) >= 6)
    ecg, beats = h10.truth.samples("ecg"), h10.truth.samples("ibi").times
    inside = beats[(beats > ecg.times[0] + 0.1) & (beats < ecg.times[-1] - 0.1)]
    assert inside.size >= 2
    for beat_s in inside:
        near = np.abs(ecg.times - beat_s) < 0.2
        peak_s = ecg.times[near][np.argmax(ecg.values[near, 0])]
        assert peak_s == pytest.approx(beat_s, abs=1.5 / 130)


async def test_a_small_mtu_makes_small_frames_and_long_replies(make_h10: MakeH10) -> None:
    h10 = make_h10(host_mtu=23)
    async with connection(NAME) as host:
        await open_pmd(host)
        assert (await host.ask(CONTROL, "0102"))[:10] == "f001020001"
        await until(lambda: len(host.all(CONTROL)) == 2)
        assert b"".join(data[5:] for data in host.all(CONTROL)).hex() == (
            "0004190032006400c800010110000203020004000800"
        )
        await host.ask(CONTROL, START_ECG)
        await until(lambda: len(frames_of(host, 0)) >= 20)
        frames = frames_of(host, 0)[:20]
    assert {len(frame.body) for frame in frames} == {9}
    values = [uv for frame in frames for uv in int24(frame.body)]
    assert h10.truth.samples("ecg").values[:60, 0].tolist() == values


async def test_compressed_acceleration_is_smaller_and_the_truth(make_h10: MakeH10) -> None:
    h10 = make_h10(Quirks(compressed_acceleration=True))
    async with connection(NAME) as host:
        await open_pmd(host)
        await host.ask(CONTROL, START_ACC)
        await until(lambda: len(frames_of(host, 2)) >= 3)
        frames = frames_of(host, 2)
    assert {frame.layout for frame in frames} == {0x81}
    truth = h10.truth.samples("acc").values
    first = np.frombuffer(frames[0].body[:6], "<i2")
    np.testing.assert_allclose(truth[0], first / 1000, atol=1e-12)
    count = 1
    at = 6
    while at < len(frames[0].body):
        count += frames[0].body[at + 1]
        at += 2 + -(-frames[0].body[at] * frames[0].body[at + 1] * 3 // 8)
    assert at == len(frames[0].body)
    assert count > 36
    np.testing.assert_allclose(
        truth[count], np.frombuffer(frames[1].body[:6], "<i2") / 1000, atol=1e-12
    )


async def test_the_true_rate_is_in_the_stamps(make_h10: MakeH10) -> None:
    h10 = make_h10(Quirks(sampling_deviation=0.015, first_sample_s=0.5))
    async with connection(NAME) as host:
        await open_pmd(host)
        asked_s = local_clock()
        await host.ask(CONTROL, START_ECG)
        await until(lambda: len(frames_of(host, 0)) >= 3)
        stamps = [frame.stamp_ns for frame in frames_of(host, 0)]
    np.testing.assert_allclose(np.diff(stamps), 73e9 / (130 * 1.015), atol=2)
    times = h10.truth.samples("ecg").times
    np.testing.assert_allclose(np.diff(times), 1 / (130 * 1.015))
    assert times[0] >= asked_s + 0.5


async def test_pairing_can_be_demanded(make_h10: MakeH10) -> None:
    make_h10(Quirks(demands_pairing=True))
    async with connection(NAME) as host:
        assert bytes(await host.client.read_gatt_char("2a19")) == b"\x57"
        with pytest.raises(BleakGATTProtocolError) as refused:
            await host.client.write_gatt_char(CONTROL, b"\1\0", response=True)
        assert refused.value.code == 0x05
        await host.client.pair()
        await open_pmd(host)
        assert await host.ask(CONTROL, START_ECG) == "f002000000"


@pytest.mark.parametrize("firmware", [Firmware.OLD, Firmware.HEART_RATE_ONLY])
async def test_other_firmware_has_no_pmd(make_h10: MakeH10, firmware: Firmware) -> None:
    h10 = make_h10(Quirks(firmware=firmware))
    async with connection(NAME) as host:
        services = host.client.services
        assert services.get_service(PMD_SERVICE) is None
        uuids = {one.uuid[:8] for one in services.characteristics.values()}
        assert ("fb005c51" in uuids) == ("fb005c52" in uuids) == (firmware is Firmware.OLD)
        await host.subscribe(HEART_RATE)
        await host.more(HEART_RATE, 2, 0)
        h10.stop_measurements(Measurement.ECG)
    assert "hr" in h10.truth.data_names


async def test_a_former_host_may_have_left_a_measurement_on(make_h10: MakeH10) -> None:
    make_h10(Quirks(left_streaming=(Measurement.ECG,), keeps_streaming=True))
    async with connection(NAME) as host:
        await open_pmd(host)
        await until(lambda: frames_of(host, 0))
        assert await host.ask(CONTROL, START_ECG) == "f002000600"
    async with connection(NAME) as host:
        await open_pmd(host)
        assert await host.ask(CONTROL, START_ECG) == "f002000600"
        assert await host.ask(CONTROL, "0300") == "f003000000"
        assert await host.ask(CONTROL, START_ECG) == "f002000000"


async def test_measurements_end_with_the_link(h10: SimulatedPolarH10) -> None:
    async with connection(NAME) as host:
        await open_pmd(host)
        await host.ask(CONTROL, START_ECG)
    await until(lambda: h10.truth.unsent_count("ecg") >= 1)
    async with connection(NAME) as host:
        await open_pmd(host)
        assert await host.ask(CONTROL, START_ECG) == "f002000000"


async def test_it_can_stop_by_itself_and_says_so(h10: SimulatedPolarH10) -> None:
    async with connection(NAME) as host:
        await open_pmd(host)
        await host.ask(CONTROL, START_ACC)
        await host.ask(CONTROL, START_ECG)
        h10.stop_measurements(Measurement.ECG, Measurement.ACC)
        assert (await host.more(CONTROL, 1, 2)) == [b"\1\0\2"]
        assert await host.ask(CONTROL, "0300") == "f003000600"


async def test_a_stop_can_be_announced_besides(make_h10: MakeH10) -> None:
    make_h10(Quirks(announces_stops=True))
    async with connection(NAME) as host:
        await open_pmd(host)
        await host.ask(CONTROL, START_ECG)
        assert await host.ask(CONTROL, "0300") == "f003000000"
        assert (await host.more(CONTROL, 1, 2)) == [b"\1\0"]


async def test_a_verity_sense_has_ppg_intervals_and_compressed_acceleration(
    make_h10: MakeH10,
) -> None:
    sense = make_h10(product=VERITY_SENSE, wearer=Wearer(heart_rate_bpm=100.0))
    async with connection(SENSE) as host:
        await open_pmd(host)
        for command in ("0203", "02010001370001011600040104"):
            assert (await host.ask(CONTROL, command))[6:8] == "00"
        reply = await host.ask(CONTROL, "0202000134000101100002010800040103")
        assert reply == "f002020000050140da7f39"
        await until(lambda: all(frames_of(host, kind) for kind in (1, 2, 3)))
        ppg, acc, ppi = (frames_of(host, kind)[0] for kind in (1, 2, 3))
    assert (ppg.layout, acc.layout, ppi.layout, ppi.stamp_ns) == (0x80, 0x80, 0, 0)
    reference = [int.from_bytes(ppg.body[at : at + 3], "little", signed=True) for at in (0, 3, 6)]
    assert sense.truth.samples("ppg").values[0, :3].tolist() == reference
    counts = np.frombuffer(acc.body[:6], "<i2")
    np.testing.assert_allclose(sense.truth.samples("acc").values[0], counts * 0.000244)
    lengths = [int.from_bytes(ppi.body[at + 1 : at + 3], "little") / 1000 for at in (0, 6)]
    assert sense.truth.samples("ppi").values[:2, 0].tolist() == lengths
    assert ppi.body[5] & 0b111 == 0b110
