"""The virtual sensor's frames and settings, against vectors and a decoder of this file's own."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.polar_h10.simulator import manufacturer_data, pmd
from biosensor_gateway.devices.polar_h10.simulator.pmd import (
    Measurement,
    PulseInterval,
    Setting,
    block,
    compress,
    encode_features,
)
from biosensor_gateway.devices.polar_h10.simulator.products import H10, waveform
from biosensor_gateway.simulation.wearer import Wearer

FOLDER = Path(__file__).parent / "vectors"
VECTORS: dict[str, dict[str, Any]] = {
    vector["name"]: vector
    for name in ("polar_pmd_h10.json", "polar_pmd_verity.json")
    for vector in json.loads((FOLDER / name).read_text())
}
Encoder = Callable[[int, Any], bytes]


def integers(values: list[Any]) -> Any:
    return np.array(values, np.int64).reshape(len(values), -1)


def acc(frame_format: int) -> Encoder:
    return lambda stamp, values: pmd.acceleration(stamp, integers(values), frame_format)


def acc_in_blocks(frame_format: int, lengths: tuple[int, ...]) -> Encoder:
    """Compressed, with blocks of given lengths instead of equal ones."""

    def encode(stamp: int, values: list[Any]) -> bytes:
        samples = integers(values)
        data = pmd.acceleration(stamp, samples[:1], frame_format)
        differences = np.diff(samples, axis=0)
        for end, length in zip(np.cumsum(lengths).tolist(), lengths, strict=True):
            data += block(differences[end - length : end])
        return data

    return encode


def ppg_with_12_bits(stamp: int, values: list[Any]) -> bytes:
    samples = integers(values)
    return pmd.ppg(stamp, samples[:1]) + block(np.diff(samples, axis=0), 12)


def ppi(stamp: int, values: list[dict[str, int]]) -> bytes:
    return pmd.pulse_intervals(
        stamp,
        [
            PulseInterval(
                one["hr"],
                one["pp_ms"],
                one["err_ms"],
                moving=bool(one["blocker"]),
                contact=bool(one["contact"]) if one["contact_supported"] else None,
            )
            for one in values
        ],
    )


ENCODERS: dict[str, tuple[str, Encoder]] = {
    "ecg_raw0_11samples": ("uv", lambda stamp, v: pmd.ecg(stamp, integers(v))),
    "ecg_raw0_73samples_full_mtu232": ("uv", lambda stamp, v: pmd.ecg(stamp, integers(v))),
    "ecg_raw0_empty": ("uv", lambda stamp, _: pmd.ecg(stamp, np.empty((0, 1), np.int64))),
    "acc_raw0_1byte_per_axis": ("mg", acc(pmd.ACC_8_BIT)),
    "acc_raw1_3samples": ("mg", acc(pmd.ACC_16_BIT)),
    "acc_raw2_3bytes_per_axis": ("mg", acc(pmd.ACC_24_BIT)),
    "acc_delta1_reference_only": ("raw", acc(pmd.ACC_COMPRESSED_MG)),
    "acc_delta1_3bit_11samples_unaligned": ("raw", acc(pmd.ACC_COMPRESSED_MG)),
    "acc_delta1_two_blocks_4bit_8bit": ("raw", acc_in_blocks(pmd.ACC_COMPRESSED_MG, (3, 2))),
    "acc_delta0_own_factor": ("raw", acc_in_blocks(pmd.ACC_COMPRESSED_COUNTS, (2, 1))),
    "ppg_delta0_12bit": ("ppg", ppg_with_12_bits),
    "ppi_raw0_two": ("ppi", ppi),
}


def test_there_is_an_encoder_for_every_frame_of_the_vectors() -> None:
    data_frames = {name for name, vector in VECTORS.items() if vector.get("kind") == "data"}
    # No simulated product sends an uncompressed PPG.
    assert ENCODERS.keys() == data_frames - {"ppg_raw0_own"}


@pytest.mark.parametrize("name", ENCODERS)
def test_it_writes_the_vectors(name: str) -> None:
    field, encode = ENCODERS[name]
    expected = VECTORS[name]["expected"]
    assert encode(expected["timestamp_ns"], expected[field]).hex() == VECTORS[name]["hex"]


def test_features_are_bits() -> None:
    for name in ("features_h10", "features_verity_sdkmode_bit"):
        features = map(Measurement, VECTORS[name]["expected"]["features"])
        assert encode_features(features).hex() == VECTORS[name]["hex"]
    assert H10.features == {Measurement.ECG, Measurement.ACC}


def decompress(data: bytes, channels: int, size: int) -> list[list[int]]:
    """Undo the compression, bit by bit."""
    samples = [
        [
            int.from_bytes(data[size * k : size * (k + 1)], "little", signed=True)
            for k in range(channels)
        ]
    ]
    at = size * channels
    while at < len(data):
        bits, count = data[at], data[at + 1]
        length = -(-bits * count * channels // 8)
        payload = int.from_bytes(data[at + 2 : at + 2 + length], "little")
        assert at + 2 + length <= len(data)
        at += 2 + length
        for _ in range(count):
            sample: list[int] = []
            for k in range(channels):
                value = payload & ((1 << bits) - 1)
                payload >>= bits
                if bits and value >> (bits - 1):
                    value -= 1 << bits
                sample.append(samples[-1][k] + value)
            samples.append(sample)
    return samples


int16 = st.integers(-(1 << 15), (1 << 15) - 1)
int22 = st.integers(-(1 << 21), (1 << 21) - 1)


@given(st.lists(st.tuples(int16, int16, int16), min_size=1, max_size=40), st.integers(1, 255))
def test_compression_can_be_undone(samples: list[tuple[int, ...]], block_samples: int) -> None:
    data = compress(integers(samples), 16, block_samples)
    assert decompress(data, 3, 2) == [list(sample) for sample in samples]


@given(st.lists(st.tuples(int22, int22, int22, int22), min_size=1, max_size=30))
def test_compression_of_22_bits_can_be_undone(samples: list[tuple[int, ...]]) -> None:
    assert decompress(compress(integers(samples), 22), 4, 3) == [list(s) for s in samples]


@given(
    st.lists(st.tuples(int16, int16, int16), min_size=1, max_size=60),
    st.sampled_from([pmd.ACC_16_BIT, pmd.ACC_COMPRESSED_MG]),
    st.integers(20, 229),
)
def test_frames_are_split_until_they_fit(
    samples: list[tuple[int, ...]], layout: int, room: int
) -> None:
    signal = waveform(
        H10,
        Measurement.ACC,
        {Setting.SAMPLE_RATE: 200, Setting.RANGE: 2},
        Wearer(),
        compressed=layout == pmd.ACC_COMPRESSED_MG,
    )
    stamps = list(range(len(samples)))
    last = -1
    decoded: list[list[int]] = []
    for part, frame in signal.split(integers(samples), stamps, room):
        assert len(frame) <= room
        last += len(part)
        assert int.from_bytes(frame[1:9], "little") == last
        if layout == pmd.ACC_16_BIT:
            decoded += np.frombuffer(frame[10:], "<i2").reshape(-1, 3).tolist()
        else:
            decoded += decompress(frame[10:], 3, 2)
    assert decoded == [list(sample) for sample in samples]


@given(st.integers(0, 2**32 - 1))
def test_no_damaged_frame_can_be_decoded(seed: int) -> None:
    for frame in pmd.damaged(np.random.default_rng(seed), 7):
        assert len(frame) <= 20
        if len(frame) < 10:
            continue
        kind, layout, body = frame[0] & 0x3F, frame[9], frame[10:]
        if (kind, layout) == (0, 0):
            assert len(body) % 3
        elif (kind, layout) == (2, 1):
            assert len(body) % 6
        elif (kind, layout) == (2, 0x81):
            cut = len(body) < 6 or -(-body[6] * body[7] * 3 // 8) > len(body) - 8
            assert cut
        else:
            assert kind == 14 or layout == 0x3F


def test_a_real_advertisement_is_reproduced() -> None:
    data = manufacturer_data(battery_low=True, contact=True, counter=4, bpm=56)
    assert data == bytes.fromhex("33003838")
    lost = manufacturer_data(battery_low=False, contact=False, counter=9, bpm=56)
    assert lost[0] == 0b00100100
