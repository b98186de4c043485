"""Headset models: electrodes, rates and resolutions."""

from __future__ import annotations

from dataclasses import dataclass

_FULL_SCALE_UV = 20 / 39 * 2**14  # 0.51 uV a step at 14 bits
_INSIGHT = ("AF3", "T7", "Pz", "T8", "AF4")
_EPOC = (
    "AF3", "F7", "F3", "FC5", "T7", "P7", "O1", "O2", "P8", "T8", "FC6", "F4", "F8", "AF4"
)  # fmt: skip
_QUATERNION = ("Q0", "Q1", "Q2", "Q3")
_GYROSCOPE = ("GYROX", "GYROY", "GYROZ")
_FIELDS = ("ACCX", "ACCY", "ACCZ", "MAGX", "MAGY", "MAGZ")


@dataclass(frozen=True, slots=True)
class Model:
    """What a headset of one model and firmware measures.

    Attributes
    ----------
    prefix
        Of the headset's id, as in ``INSIGHT-A1B2C3D4``.
    mode
        As ``settings.mode`` names it.
    electrodes
        In the order of the columns.
    eeg_rate, eeg_bits
        Samples a second and resolution of the converter.
    motion_rate
        Samples a second; 0 = the motion sensor is switched off.
    has_gyroscope
        Older firmware: angular rates in place of the quaternion.
    firmware
        Version as the headset object has it.
    """

    prefix: str
    mode: str
    electrodes: tuple[str, ...]
    eeg_rate: int
    eeg_bits: int
    motion_rate: int
    has_gyroscope: bool
    firmware: str

    @property
    def motion_sensors(self) -> tuple[str, ...]:
        """Columns of the motion stream after its counter and flag."""
        return (*(_GYROSCOPE if self.has_gyroscope else _QUATERNION), *_FIELDS)

    @property
    def resolution_uv(self) -> float:
        """One step of the converter [uV]."""
        return _FULL_SCALE_UV / 2**self.eeg_bits


INSIGHT_1 = Model("INSIGHT", "INSIGHT", _INSIGHT, 128, 14, 64, False, "930")
INSIGHT_1_GYRO = Model("INSIGHT", "INSIGHT", _INSIGHT, 128, 14, 128, True, "925")
INSIGHT_2 = Model("INSIGHT2", "INSIGHT", _INSIGHT, 128, 16, 32, False, "a11")
EPOC_X = Model("EPOCX", "EPOCX", _EPOC, 256, 16, 64, False, "635")
