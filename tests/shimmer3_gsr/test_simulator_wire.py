"""What the virtual Shimmer3 says, byte by byte, without a link."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.devices.shimmer.simulator import wire
from biosensor_gateway.devices.shimmer.simulator.interpreter import Interpreter
from biosensor_gateway.devices.shimmer.simulator.streaming import Sampling, samples
from biosensor_gateway.devices.shimmer.simulator.wire import (
    CommandReader,
    Firmware,
    Flash,
    crc16,
    data_packet,
    sealed,
)
from biosensor_gateway.devices.shimmer3_gsr.simulator import (
    AUTO_RANGE,
    Conditions,
    GsrAmplifier,
    GsrMeter,
    conductance_us,
    counts_in,
    ppg_mv,
)
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import Oscillator
from biosensor_gateway.system.clock import LSL_CLOCK

NEWEST = Firmware(1, 1, 2)
VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors" / "shimmer3.json").read_text()
)["vectors"]
# Names of the values in a data packet's expectation, in the order of its channels.
FIELDS = {
    (18, 28): ("int_adc_a13", "gsr_raw"),
    (3, 18, 28): ("vbatt", "int_adc_a13", "gsr_raw"),
    (0, 1, 2, 18, 28): ("accel_ln_x", "accel_ln_y", "accel_ln_z", "int_adc_a13", "gsr_raw"),
    (29, 30, 31, 32, 33, 34): (
        *("exg1_status", "exg1_ch1_24", "exg1_ch2_24"),
        *("exg2_status", "exg2_ch1_24", "exg2_ch2_24"),
    ),
}


def sampling(oscillator: Oscillator, jitter_s: float = 0.0) -> Sampling:
    return Sampling(
        channels=(0x12, 0x1C),
        divider=256,
        meter=GsrMeter(
            (0x12, 0x1C),
            AUTO_RANGE,
            256,
            Wearer(),
            lambda: Conditions(worn=True, probe_powered=True, battery_counts=2700),
        ),
        wearer_born_s=oscillator.true_time(0.0),
        oscillator=oscillator,
        first_tick=0,
        rng=np.random.default_rng(0),
        jitter_s=jitter_s,
    )


def of_kind(*kinds: str) -> Any:
    chosen = [each for each in VECTORS if each["kind"] in kinds]
    assert chosen
    return pytest.mark.parametrize("vector", chosen, ids=[each["name"] for each in chosen])


class BareInterpreter:
    """An interpreter without link or clock."""

    def __init__(self, firmware: Firmware = NEWEST) -> None:
        self.counts = 2646
        self.now = 0
        self.flash = Flash()
        self.interpreter = Interpreter(firmware, self.flash, self)
        self._reader = CommandReader(firmware)

    def ticks(self) -> int:
        return self.now

    def battery_counts(self) -> int:
        return self.counts

    def say(self, *commands: str) -> str:
        """Send commands as hexadecimal digits; return the last answer's."""
        answer = b""
        for command in commands:
            for each in self._reader.feed(bytes.fromhex(command)):
                message = self.interpreter.execute(each)
                answer = sealed(message, self.interpreter.crc_bytes)
        return answer.hex()


@of_kind("command")
def test_every_command_is_acknowledged(vector: dict[str, Any]) -> None:
    bench = BareInterpreter()
    assert bench.say(vector["hex"])[:2] == "ff"
    expected = vector["expected"]
    if "channels" in expected:
        assert bench.say("01")[20:] == bytes(expected["channels"]).hex()
        assert bench.flash.sensors == expected["mask"]
    if "rate_hz" in expected:
        assert 32768 / bench.flash.divider == expected["rate_hz"]


def test_responses_are_those_of_the_vectors() -> None:
    expected = {each["name"]: each["hex"] for each in VECTORS if each["kind"] == "response"}
    bench = BareInterpreter()
    gyro = bench.say("08400000", "058002", "0e00000005", "01")
    assert gyro == "ff" + expected["rsp_inquiry_gyro_exp_gsr2"]
    skin = bench.say("08040100", "050001", "0e029b3909", "01")
    assert skin == expected["rsp_inquiry_gsr_ppg_auto_128Hz"]
    assert bench.say("2104", "23") == expected["rsp_gsr_range_auto"]
    assert bench.say("5e01", "60") == expected["rsp_exp_power_on"]
    assert bench.say("07", "08000000") == expected["nack"]


@of_kind("data", "stream")
def test_data_packets_are_those_of_the_vectors(vector: dict[str, Any]) -> None:
    channels = tuple(vector["channels"])
    expected = vector["expected"]
    if vector["kind"] == "stream":
        after, before = expected["ts"][1] + (1 << 24), expected["ts"][0]
        assert after - before == expected["delta_ticks"]
        packets = [data_packet(before, channels, (1820, 0x49C4))]
        packets.append(data_packet(after, channels, (1821, 0x49C4)))
        assert b"".join(packets).hex() == vector["hex"]
        return
    values = [expected[name] for name in FIELDS[channels]]
    assert (
        sealed(data_packet(expected["ts"], channels, values), vector["crc"]).hex()
        == (vector["hex"])
    )


@of_kind("gsr")
def test_words_of_skin_conductance_mean_what_the_vectors_say(vector: dict[str, Any]) -> None:
    raw = int.from_bytes(bytes.fromhex(vector["hex"]), "little")
    expected = vector["expected"]
    found = conductance_us(raw, vector["range_setting"])
    if expected["range"] == 3 and expected["adc"] <= 683:
        assert math.isnan(found)
    else:
        assert found == pytest.approx(expected["usiemens"], rel=1e-9)


@of_kind("gsr_clamp")
def test_fixed_ranges_end_where_the_vendor_ends_them(vector: dict[str, Any]) -> None:
    expected = vector["expected"]
    gsr_range = expected["range"]
    raw = gsr_range << 14 | counts_in(gsr_range, 1000 / expected["in_kohm"])
    found_kohm = 1000 / conductance_us(raw, gsr_range)
    # No more exact than the converter, which cannot say less than 8.04 kohm.
    assert found_kohm == pytest.approx(expected["out_kohm"], rel=6e-3)


@of_kind("adc")
def test_pulse_voltages_are_those_of_the_vectors(vector: dict[str, Any]) -> None:
    counts = int.from_bytes(bytes.fromhex(vector["hex"]), "little")
    assert ppg_mv(counts) == pytest.approx(vector["expected"]["mv"])


@of_kind("vbatt")
def test_battery_readings_are_those_of_the_vectors(vector: dict[str, Any]) -> None:
    expected = vector["expected"]
    assert wire.percent_of(expected["adc"]) == pytest.approx(expected["percent"])
    bench = BareInterpreter()
    bench.counts = expected["adc"]
    assert bench.say("95").startswith("ff8a94" + vector["hex"][:4])


def test_the_charger_is_unknown_out_of_the_dock_then_charging_then_full() -> None:
    bench = BareInterpreter()
    assert bench.say("95") == "ff8a94560aff"
    bench.interpreter.docked = True
    assert bench.say("95") == "ff8a94560a80"
    bench.counts = wire.counts_at(100)
    assert bench.say("95")[-2:] == "40"


def test_the_check_is_the_vendors() -> None:
    assert crc16(bytes(range(1, 9))) == 0x48AA
    assert crc16(bytes(range(1, 10))) == 0x2A5D
    assert sealed(b"\xff", 1).hex() == "fff4"
    assert sealed(bytes.fromhex("ff8a94560a80"), 1).hex() == "ff8a94560a8038"
    assert sealed(bytes.fromhex("00efbe1be7093c083f09"), 1)[-1] == 0x7A


def test_every_message_carries_the_check_from_its_own_answer_on() -> None:
    bench = BareInterpreter()
    assert bench.say("8b01") == "fff4"
    assert bench.say("3f") == sealed(bytes.fromhex("ff2503"), 1).hex()
    assert bench.say("8b02") == sealed(b"\xff", 2).hex()
    assert bench.say("07", "5e01") == sealed(b"\xfe", 2).hex()
    assert bench.say("8b00") == "ff"


def test_commands_of_the_firmware_at_that_time() -> None:
    old = BareInterpreter(Firmware(0, 11, 0))
    # It knows neither the check nor its argument, which it takes for an inquiry.
    assert old.say("8b01")[:4] == "ff02"
    # The same for the prefix, whose argument is no command at all.
    assert old.say("a300") == ""
    assert BareInterpreter(Firmware(0, 13, 7)).say("8b01") == "fff4"
    assert BareInterpreter(Firmware(0, 16, 11)).say("a300") == "ff"


def test_a_blocked_command_is_refused_aloud_or_ignored() -> None:
    for firmware, answer in ((NEWEST, "fe"), (Firmware(0, 16, 11), "ff")):
        bench = BareInterpreter(firmware)
        bench.say("07")
        for command in ("050001", "08040100", "0e029b3909", "2104", "5e01", "790141"):
            assert bench.say(command) == answer
        assert (bench.flash.divider, bench.flash.sensors) == (640, 0x80)
        assert bench.say("03") == "ff048002"
        assert bench.say("20", "050001") == "ff"
        assert bench.flash.divider == 256


def test_unknown_commands_are_passed_over_and_arguments_are_waited_for() -> None:
    bench = BareInterpreter()
    assert bench.say("0088ee") == ""
    assert bench.say("05") == ""
    assert bench.say("00") == ""
    assert bench.say("01") == "ff"
    assert bench.flash.divider == 256


def test_it_says_who_it_is() -> None:
    bench = BareInterpreter()
    assert bench.say("2e") == "ff2f030001000102"
    assert bench.say("3f") == bench.say("24") == "ff2503"
    assert bench.say("660300") == "ff6503300400"
    assert bench.say("66ff00") == "fe"
    assert bench.say("7b") == "ff7a0c" + b"Shimmer_4E5F".hex()
    assert bench.say("7903616263", "7b") == "ff7a03616263"
    assert bench.say("790d" + 13 * "61") == "fe"
    calibration = bytes.fromhex(bench.say("2c"))
    assert len(calibration) == 2 + 84
    assert int.from_bytes(calibration[2:4], "big") == 2253
    assert int.from_bytes(calibration[8:10], "big") == 92


def test_the_first_65_ms_are_not_sent() -> None:
    oscillator = Oscillator(LSL_CLOCK)
    earliest = oscillator.now() * 32768
    first = next(samples(sampling(oscillator)))
    latest = oscillator.now() * 32768
    ticks = int.from_bytes(first.packet[1:4], "little")
    assert earliest + 0.065 * 32768 - 2 <= ticks <= latest + 0.065 * 32768 + 256


class TestAutoRange:
    DIVIDER = 256
    HELD = 2621 // DIVIDER

    def words(self, conductances: list[float]) -> list[tuple[int, int]]:
        raw = GsrAmplifier(AUTO_RANGE, self.DIVIDER).measure(conductances)
        return [(word >> 14, word & 0xFFF) for word in raw]

    @pytest.mark.parametrize(
        ("microsiemens", "gsr_range"), [(40.0, 0), (8.0, 1), (2.0, 2), (0.5, 3), (0.0, 3)]
    )
    def test_it_settles_on_the_resistor_that_fits(
        self, microsiemens: float, gsr_range: int
    ) -> None:
        last_range, last_counts = self.words([microsiemens] * 100)[-1]
        assert last_range == gsr_range
        found = conductance_us(last_range << 14 | last_counts, AUTO_RANGE)
        if microsiemens:
            assert found == pytest.approx(microsiemens, rel=5e-3)
        else:
            assert math.isnan(found)

    def test_it_switches_at_the_firmwares_readings_both_ways(self) -> None:
        slowly_up = [0.1 * 1.002**k for k in range(3600)]
        words = self.words([0.1] * 60 + slowly_up + slowly_up[::-1])
        pairs = list(itertools.pairwise(words))
        switches = [(old, new) for old, new in pairs if old[0] != new[0]][3:]
        assert [(old[0], new[0]) for old, new in switches] == [
            (3, 2),
            (2, 1),
            (1, 0),
            (0, 1),
            (1, 2),
            (2, 3),
        ]
        limits = [3930, 3700, 3960, 1120, 1490, 1630]
        for (old, _), limit in zip(switches, limits, strict=True):
            assert old[1] == pytest.approx(limit, abs=12)
            assert (old[1] > limit) == (limit > 2000)
