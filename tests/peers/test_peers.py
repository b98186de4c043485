"""Other people's clients accept the virtual devices and read what they measured."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial
from numpy.typing import ArrayLike, NDArray

from tests.rigs.lab_client import LabProcess, Samples

pytestmark = pytest.mark.nightly

# Other people's clients accept the virtual devices and read from them what was measured.

PEERS = Path(__file__).parent
ENVIRONMENT = PEERS.parents[1] / ".venv-peers"
DEADLINE_S = 100.0
KEY = "device"
DRIFT_PPM = 120.0
H10 = "Polar H10 A1B2C3D4"
BELT = "GDX-RB 0K2002Z5"
SENSE = "Polar Sense 5E45E001"
OF_THREE_AXES = {"RESOLUTION": [16], "CHANNELS": [3]}
SENSE_SETTINGS = {
    "PPG": {"SAMPLE_RATE": [55], "RESOLUTION": [22], "CHANNELS": [4]},
    "ACC": {"SAMPLE_RATE": [52], "RANGE": [8], **OF_THREE_AXES},
    "GYRO": {"SAMPLE_RATE": [52], "RANGE": [2000], **OF_THREE_AXES},
    "MAG": {"SAMPLE_RATE": [10, 20, 50, 100], "RANGE": [50], **OF_THREE_AXES},
}
H10_SETTINGS = {
    "ECG": {"SAMPLE_RATE": [130], "RESOLUTION": [14]},
    "ACC": {"SAMPLE_RATE": [25, 50, 100, 200], "RESOLUTION": [16], "RANGE": [2, 4, 8]},
}
SHIMMER_RESISTORS_KOHM = np.array([40.2, 287.0, 1000.0, 3300.0])
Floats = NDArray[np.float64]


@contextmanager
def laboratory(tmp_path: Path, sensor: str, **options: Any) -> Generator[LabProcess]:
    """One virtual device with a drifting oscillator and a radio that delays."""
    # A skip would pass where nothing was tried.
    if not (ENVIRONMENT / ".installed").exists():
        pytest.fail("the peers are not installed: run `make venv-peers` first")
    options = {"seed": 7, "jitter_s": 0.02, "drift_ppm": DRIFT_PPM, **options}
    with LabProcess([{"key": KEY, "sensor": sensor, "options": options}], tmp_path) as lab:
        yield lab


@contextmanager
def peer(lab: LabProcess, program: str, *arguments: str) -> Generator[subprocess.Popen[str]]:
    """A client at work; it does not outlive the test."""
    with subprocess.Popen(
        [ENVIRONMENT / "bin" / "python", PEERS / program, *arguments],
        env={**os.environ, **lab.environment},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def result(process: subprocess.Popen[str], told: str = "") -> dict[str, Any]:
    """What a client read, once it has ended."""
    output, errors = process.communicate(told, timeout=DEADLINE_S)
    assert process.returncode == 0, errors
    return json.loads(output)


def assert_read(received: ArrayLike, sent: Floats, *, complete: bool = False) -> None:
    """Received is what was sent, from the first sample on; all of it if complete."""
    values = np.asarray(received, np.float64)
    values = values.reshape(len(values), -1)
    assert 0 < len(values) <= len(sent)
    assert not complete or len(values) == len(sent)
    # The units of the wire are coarser by far.
    np.testing.assert_allclose(values, sent[: len(values)], rtol=0, atol=1e-9)


def assert_stamps(frames: dict[str, Any], sent: Samples) -> None:
    """Each frame is stamped with the time of its last sample on the drifting device's clock."""
    last = np.cumsum(frames["sizes"]) - 1
    device_s = (np.array(frames["stamps_ns"]) - frames["stamps_ns"][0]) / 1e9
    true_s = sent.times[last] - sent.times[last[0]]
    np.testing.assert_allclose(device_s, true_s * (1 + DRIFT_PPM * 1e-6), rtol=0, atol=1e-6)


def known(rates: list[float]) -> list[float]:
    """The heart rates but for 0, which stands for none."""
    return [rate for rate in rates if rate]


def test_bleakheart_reads_the_polar_h10(tmp_path: Path) -> None:
    with laboratory(tmp_path, "polar_h10") as lab:
        with peer(lab, "bleakheart_reads.py", H10) as process:
            read = result(process)
        truth = lab.truth(KEY)
    assert read["measurements"] == ["ECG", "ACC"]
    fine = {"error_code": 0, "error_msg": "SUCCESS"}
    assert read["settings"] == {kind: fine | offered for kind, offered in H10_SETTINGS.items()}
    assert read["started"] == read["stopped"] == [0, 0]
    assert read["battery_percent"] == truth["bat"].values[0, 0]
    assert_read(known(read["hr"]), truth["hr"].values)
    # The client rounds intervals to whole milliseconds.
    assert_read(read["rr_ms"], np.round(truth["ibi"].values * 1000))
    assert_read(read["ecg"]["samples"], truth["ecg"].values, complete=True)
    assert_read(np.array(read["acc"]["samples"]) / 1000, truth["acc"].values, complete=True)
    for name in ("ecg", "acc"):
        assert_stamps(read[name], truth[name])


def test_polar_python_reads_the_polar_h10(tmp_path: Path) -> None:
    with laboratory(tmp_path, "polar_h10") as lab:
        with peer(lab, "polar_python_reads.py", H10) as process:
            read = result(process)
        truth = lab.truth(KEY)
    assert read["measurements"] == ["ECG", "ACC"]
    assert read["settings"] == H10_SETTINGS
    assert_read(known(read["hr"]), truth["hr"].values)
    assert_read(np.array(read["rr_ms"]) / 1000, truth["ibi"].values)
    assert_read(read["ecg"]["samples"], truth["ecg"].values)
    assert_read(np.array(read["acc"]["samples"]) / 1000, truth["acc"].values)
    for name in ("ecg", "acc"):
        assert_stamps(read[name], truth[name])
        # A clock that nobody has set starts there.
        assert datetime.fromtimestamp(read[name]["stamps_ns"][0] / 1e9, UTC).year == 2019


def test_polar_python_reads_the_verity_sense(tmp_path: Path) -> None:
    with laboratory(tmp_path, "polar_verity_sense") as lab:
        with peer(lab, "polar_python_reads_light.py", SENSE) as process:
            read = result(process)
        truth = lab.truth(KEY)
    assert set(read["measurements"]) == {"PPI", *SENSE_SETTINGS}
    assert read["settings"] == SENSE_SETTINGS
    assert_read(np.array(read["ppi"]) / 1000, truth["ppi"].values)
    assert_read(read["ppg"]["samples"], truth["ppg"].values)
    # In mg cut off to whole ones, in deg/s and in gauss; the factor came as a float of 32 bits.
    for name, unit in (("acc", 1000.0), ("gyro", 1.0), ("mag", 0.01)):
        values = np.array(read[name]["samples"])
        np.testing.assert_allclose(
            values, truth[name].values[: len(values)] * unit, rtol=1e-6, atol=float(name == "acc")
        )
    for name in ("ppg", "acc", "gyro", "mag"):
        assert_stamps(read[name], truth[name])


def test_bleakheart_reads_the_verity_sense_in_its_sdk_mode(tmp_path: Path) -> None:
    with laboratory(tmp_path, "polar_verity_sense") as lab:
        with peer(lab, "bleakheart_reads_light.py", SENSE) as process:
            read = result(process)
        truth = lab.truth(KEY)
    assert set(read["measurements"]) == {"PPI", *SENSE_SETTINGS}
    fine = {"error_code": 0, "error_msg": "SUCCESS"}
    assert read["settings"] == {kind: fine | offered for kind, offered in SENSE_SETTINGS.items()}
    assert read["sdk_settings"]["SAMPLE_RATE"] == [28, 44, 55, 135, 176]
    assert read["codes"] == [0, 0, 0, 0]
    assert_read(known(read["hr"]), truth["hr"].values)
    # It reads bits of a difference from the wrong end, but for 8 of them; what a frame begins
    # with and how many samples it holds is right.
    first = np.concatenate(([0], np.cumsum(read["sizes"])[:-1]))
    np.testing.assert_array_equal(read["references"], truth["ppg"].values[first])
    assert_stamps(read, truth["ppg"])


def test_godirect_drives_the_respiration_belt(tmp_path: Path) -> None:
    periods_ms = (50, 100)
    with laboratory(tmp_path, "vernier_respiration_belt", warm_up_s=2.0) as lab:
        with peer(lab, "godirect_reads.py", BELT, *map(str, periods_ms)) as process:
            read = result(process)
        truth = lab.truth(KEY)
    assert f"{read['order_code']} {read['serial']}" == BELT
    assert read["address"] == "e0:f5:bd:94:6a:1b"
    assert read["battery_percent"] == truth["bat"].values[0, 0]
    assert read["rssi"] == truth["rssi"].values[0, 0]
    assert read["channels"] == [
        [1, "Force", "N"], [2, "Respiration Rate", "bpm"], [4, "Steps", ""], [5, "Step Rate", "spm"]
    ]  # fmt: skip
    for run in read["runs"]:
        assert run["started"] and run["stopped"] and all(run["reads"])
        # The belt knows no rate at first, and does later.
        assert np.isnan(run["rate"][0]) and not np.isnan(run["rate"][-1])
    assert_read(_joined(read["runs"], "force"), truth["force"].values, complete=True)
    assert_read(_joined(read["runs"], "rate"), truth["bpm"].values, complete=True)
    first = len(read["runs"][0]["force"])
    for part, period_ms in zip(np.split(truth["force"].times, [first]), periods_ms, strict=True):
        device_s = np.diff(part) * (1 + DRIFT_PPM * 1e-6)
        np.testing.assert_allclose(device_s, period_ms / 1000, rtol=0, atol=1e-6)


def _joined(runs: list[dict[str, Any]], name: str) -> list[float]:
    return [value for run in runs for value in run[name]]


# It takes the ACK before a pushed status for an answer, so the oldest is not docked.
@pytest.mark.parametrize(
    ("firmware", "dock"), [((0, 11, 0), False), ((0, 16, 11), True), ((1, 1, 2), True)]
)
def test_pyshimmer_drives_the_shimmer3(
    tmp_path: Path, firmware: tuple[int, int, int], dock: bool
) -> None:
    with laboratory(tmp_path, "shimmer3_gsr", firmware=firmware) as lab:
        port = lab.settings[KEY]["port"]
        _power_the_probe(port)
        with peer(lab, "pyshimmer_reads.py", port) as process:
            assert process.stderr is not None
            assert process.stderr.readline() == "streaming\n"
            if dock:
                lab.call(KEY, "dock", docked=True)
            read = result(process, "docked\n" if dock else "\n")
        truth = lab.truth(KEY)
    assert read["firmware"] == ["LogAndStream", *firmware]
    assert read["name"] == "Shimmer_4E5F"
    assert read["battery_percent"] == pytest.approx(truth["bat"].values[0, 0])
    assert read["rate_hz"] == 128
    assert read["inquiry"] == [128, 1, ["VBATT", "INTERNAL_ADC_13", "GSR_RAW"]]
    # A clock that was set goes on from there.
    assert read["rtc_s"] >= 0
    assert read["status"] == [False, False, True, False, False, True, False, False]
    assert read["status_after"][1] is False
    docked_and_streaming = [True, True, True, False, True, True, False, False]
    assert read["pushed"] == ([docked_and_streaming] if dock else [])
    packets = np.array(read["packets"])
    assert set(np.diff(packets[:, 0]) % (1 << 24)) == {256}
    assert_read(packets[:, 2] * 3000 / 4095, truth["ppg"].values)
    gain = (packets[:, 3] & 0xFFF) * 6 / 4095 - 1
    resistors_kohm = SHIMMER_RESISTORS_KOHM[packets[:, 3] >> 14]
    assert_read(gain * 1000 / resistors_kohm, truth["gsr"].values)


def _power_the_probe(port: str) -> None:
    """Do what the client has no command for; it is kept in flash."""
    with serial.Serial(port, timeout=10) as opened:
        opened.write(bytes.fromhex("5e012104"))
        assert opened.read(2) == b"\xff\xff"


# BrainFlow reads from a virtual EmotiBit what it measured; see :mod:`tests.peers.test_peers`.
DEVICE = "MD-V5-0000321"
PORT = 3131
"""The client knows no other one."""


@pytest.mark.skipif(sys.platform != "linux", reason="only there each loopback address is one's own")
def test_brainflow_reads_the_emotibit(tmp_path: Path) -> None:
    # Others may have a device on the same port, on this computer.
    dice = random.Random(os.urandom(8))
    address = f"127.{dice.randrange(1, 255)}.{dice.randrange(1, 255)}.{dice.randrange(1, 255)}"
    with laboratory(tmp_path, "emotibit", device=DEVICE, host=address, port=PORT) as lab:
        with peer(lab, "brainflow_reads_emotibit.py", address, DEVICE) as process:
            read = result(process)
        truth = lab.truth(KEY)
    for name in ("acc", "gyro", "mag", "ppg", "eda"):
        sent = truth[name].values
        assert 50 <= len(read[name]) <= len(sent), name
        np.testing.assert_allclose(read[name], sent[: len(read[name])], rtol=0, atol=1e-9)


# Other people's clients read the sensors of virtual Shimmer units.
GRAVITY_MS2 = 9.80665
AXES = "XYZ"
# Stream, the client's channels, block of the memory, units of it in one of the stream.
MOTION = (
    ("acc_low_noise", "ACCEL_LN_", 0, GRAVITY_MS2),
    ("gyro", "GYRO_MPU9150_", 1, 100.0),
    ("mag", "MAG_LSM303DLHC_", 2, 1.0),
    ("acc_wide_range", "ACCEL_LSM303DLHC_", 3, GRAVITY_MS2),
)
LEADS = ("EXG_ADS1292R_1_CH1_24BIT", "EXG_ADS1292R_1_CH2_24BIT", "EXG_ADS1292R_2_CH2_24BIT")
FULL_SCALE = (1 << 23) - 1


def calibrated(raw: Floats, block: dict[str, Any]) -> Floats:
    """What the vendor's manual makes of readings: R^-1 K^-1 (u - b), K of the gyroscope x 100."""
    turned = np.linalg.inv(np.array(block["alignment"]).reshape(3, 3) / 100)
    return ((raw - block["offset"]) / block["sensitivity"]) @ turned.T


def test_pyshimmer_reads_all_sensors_of_an_exg_unit(tmp_path: Path) -> None:
    with laboratory(tmp_path, "shimmer") as lab:
        with peer(lab, "pyshimmer_units_reads.py", lab.settings[KEY]["port"]) as process:
            read = result(process)
        truth = lab.truth(KEY)
    packets = read["packets"]
    assert len(packets) == 100
    assert len(read["channels"]) == len(packets[0]) - 1

    def columns(*names: str) -> Floats:
        return np.array([[packet[name] for name in names] for packet in packets], np.float64)

    for name, prefix, block, unit in MOTION:
        raw = columns(*(prefix + axis for axis in AXES))
        # Its sensitivity is in hundredths of that of the others.
        scale = 1 / unit if name != "gyro" else unit
        assert_read(calibrated(raw, read["calibration"][block]) * scale, truth[name].values)
    (first, second), (_, fourth) = read["gains"]
    microvolts = columns(*LEADS) * 2.42e6 / FULL_SCALE / np.array([first, second, fourth])
    assert_read(microvolts, truth["ecg"].values)
    air = columns("TEMP_BMPX80", "PRESSURE_BMPX80")
    assert_affine(air, np.hstack([truth[name].values for name in ("temp", "pressure")]), 1e-4)
    assert set(columns("EXG_ADS1292R_1_STATUS").ravel()) == {0x80}


def assert_affine(raw: Floats, sent: Floats, relative: float) -> None:
    """What was sent depends on raw values as a matrix and an offset say, to so small a part."""
    sent = sent[: len(raw)]
    given = np.hstack([raw, np.ones((len(raw), 1))])
    found = np.linalg.lstsq(given, sent, rcond=None)[0]
    left = np.abs(given @ found - sent).max(axis=0)
    assert np.all(left <= relative * np.ptp(sent, axis=0))


@pytest.mark.parametrize("sensor", ["shimmer", "shimmer:imu"])
def test_brainflow_reads_units_of_both_series(tmp_path: Path, sensor: str) -> None:
    with laboratory(tmp_path, sensor) as lab:
        port = lab.settings[KEY]["port"]
        _leave_one_accelerometer_on(port)
        with peer(lab, "brainflow_reads.py", port) as process:
            read = result(process)
        truth = lab.truth(KEY)
    assert read["told"] == "OK"
    streams = (("accel", "acc_wide_range"), ("gyro", "gyro"), ("magnetometer", "mag"))
    for kind, name in streams:
        raw = np.array(read[kind]).T
        assert len(raw) == 100
        if name == "mag" and sensor == "shimmer":
            # A Shimmer3's magnetometer has the high byte first, which this client does not know.
            raw = raw.astype("<i2").byteswap().astype(np.float64)
        # It leaves calibration to others, which is a matrix and an offset.
        assert_affine(raw, truth[name].values, 1e-9)
    if sensor == "shimmer":
        raw = np.array(read["ecg"]).T[:, [0, 1, 3]]
        assert_read(raw * 2.42e6 / FULL_SCALE / 4, truth["ecg"].values)


def _leave_one_accelerometer_on(port: str) -> None:
    """Do what the client has to be given: it refuses a device that has two on."""
    with serial.Serial(port, timeout=10) as opened:
        opened.write(bytes.fromhex("08781000"))
        assert opened.read(1) == b"\xff"
