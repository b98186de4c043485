"""Other firmware, products and circumstances of the virtual sensor, through plain bleak."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from bleak.exc import BleakGATTProtocolError

from biosensor_gateway.devices.polar_h10.simulator.pmd import Measurement
from biosensor_gateway.devices.polar_h10.simulator.products import Firmware, Quirks
from biosensor_gateway.simulation.radio import Radio
from tests.polar_h10.steering import SteeredPolarH10
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.gatt_host import connection
from tests.rigs.polar_h10 import (
    CONTROL,
    HEART_RATE,
    NAME,
    START_ACC,
    START_ECG,
    frames_of,
    int24,
    open_pmd,
)
from tests.rigs.polling import until

PMD_SERVICE = "fb005c80-02e7-f387-1cad-8acd2d8df0c8"
MakeH10 = Callable[..., SteeredPolarH10]

pytestmark = ON_BUMBLE


@pytest.mark.parametrize("host_mtu", [23])
async def test_a_small_mtu_makes_small_frames_and_long_replies(make_h10: MakeH10) -> None:
    h10 = make_h10()
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


async def test_the_true_rate_is_in_the_stamps(make_h10: MakeH10, radio: Radio) -> None:
    h10 = make_h10(Quirks(sampling_deviation=0.015, first_sample_s=0.5))
    async with connection(NAME) as host:
        await open_pmd(host)
        asked_s = radio.world.clock()
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
