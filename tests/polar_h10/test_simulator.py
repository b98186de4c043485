"""The virtual Polar H10 on the virtual radio, heard through plain bleak."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from bleak.exc import BleakGATTProtocolError

from biosensor_gateway.simulation.wearer import Wearer
from tests.polar_h10.steering import SteeredPolarH10
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.gatt_host import advertised, connection
from tests.rigs.polar_h10 import (
    CONTROL,
    HEART_RATE,
    NAME,
    START_ACC,
    START_ECG,
    frames_of,
    open_pmd,
)
from tests.rigs.polling import until

MakeH10 = Callable[..., SteeredPolarH10]

pytestmark = ON_BUMBLE


@pytest.fixture
def h10(make_h10: MakeH10) -> SteeredPolarH10:
    return make_h10()


async def test_it_is_advertised_as_an_h10_is(h10: SteeredPolarH10) -> None:
    device, data = await advertised(NAME)
    assert device.address == "A0:9E:1A:A1:B2:C3"
    assert h10.settings == {"device": "A1B2C3D4"}
    assert {uuid[4:8] for uuid in data.service_uuids} == {"180d", "feee"}
    assert data.rssi == -58
    payload = data.manufacturer_data[0x006B]
    assert len(payload) == 4
    assert payload[0] & 0b11 == 0b10


async def test_the_handshake_is_as_published(h10: SteeredPolarH10) -> None:
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
