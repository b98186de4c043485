"""Other people's clients read the sensors of virtual Shimmer units."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial

from tests.peers.test_peers import KEY, Floats, assert_read, laboratory, peer, result

pytestmark = pytest.mark.nightly

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
