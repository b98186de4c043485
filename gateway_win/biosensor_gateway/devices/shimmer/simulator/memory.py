"""Non-volatile memory of a virtual Shimmer: factory data, and settings by the host."""

from __future__ import annotations

from dataclasses import dataclass, field

from biosensor_gateway.devices.shimmer.simulator.wire import SHIMMER3, Model

REGISTERS = 10
"""Number of registers of each ExG chip."""
BMP180, BMP280 = 0, 1
_CARD_LENGTH = 2048
# Low-noise accelerometer: offset 2253, 92 counts per m/s^2, mounting; the other blocks unset.
_LN_ACCEL_ALONE = bytes.fromhex("08cd08cd08cd005c005c005c009c009c000000009c").ljust(84, b"\xff")


@dataclass(frozen=True)
class Memory:
    """Data written in the factory.

    Attributes
    ----------
    card
        Number, revision and special revision of the expansion board.
    calibration
        Blocks of 21 bytes: low-noise accelerometer, gyroscope, magnetometer, wide-range
        accelerometer; two more on a Shimmer3R.
    pressure_chip, pressure_coefficients
        0 BMP180, 1 BMP280, 2 BMP390, 3 BMP581, and its coefficients.
    """

    model: Model = SHIMMER3
    card: tuple[int, int, int] = (48, 4, 0)
    calibration: bytes = _LN_ACCEL_ALONE
    pressure_chip: int = BMP280
    pressure_coefficients: bytes = b"\xff" * 24

    @property
    def page(self) -> bytes:
        """The memory of the expansion board."""
        return bytes(self.card).ljust(_CARD_LENGTH, b"\xff")


@dataclass
class Flash:
    """Settings that a Shimmer keeps without power.

    Attributes
    ----------
    name
        Name of the unit, at most 12 ASCII characters.
    sensors
        Sensor mask of 24 bits.
    divider
        Ticks of 1/32768 s between two samples.
    setup
        Configuration bytes, seven on a Shimmer3R; the fourth contains the expansion power (bit 0)
        and the range of the skin conductance (bits 1 to 3).
    exg
        Ten registers of each ExG chip.
    """

    name: str = "Shimmer_4E5F"
    sensors: int = 0x000080
    divider: int = 640
    setup: bytearray = field(default_factory=lambda: bytearray.fromhex("01ff0100"))
    exg: list[bytearray] = field(default_factory=lambda: [bytearray(REGISTERS) for _ in (1, 2)])

    @property
    def expansion_power(self) -> int:
        """Whether the probe is powered, 0 or 1."""
        return self.setup[3] & 1

    @expansion_power.setter
    def expansion_power(self, on: int) -> None:
        self.setup[3] = self.setup[3] & ~1 | (1 if on else 0)

    @property
    def gsr_range(self) -> int:
        """0 to 3 for a fixed resistor, 4 for auto-range."""
        return self.setup[3] >> 1 & 7

    @gsr_range.setter
    def gsr_range(self, value: int) -> None:
        self.setup[3] = self.setup[3] & ~0x0E | min(value, 4) << 1
