"""Names of streams, several devices of one kind, and what claims to be one of them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import count
from typing import TYPE_CHECKING, Any, NamedTuple

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.validate_full_topic_name import validate_full_topic_name
from std_msgs.msg import Float32, Float32MultiArray, String

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.nightly

# Names and types of streams that other programs choose, however hostile.

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STREAMS = "/lsl_to_ros/streams"
# An outlet takes two ports of the 256 that tests look at.
WAVE = 60
"""For each outlet liblsl opens about ten files, and by default a process may open 1,024."""
SUBSCRIBED = 8
HOSTILE = [
    # Quotes, blanks and what shells, XML, XPath, URLs, paths and ROS make something of.
    *("two words", " leading", "trailing ", "tab\tinside", "line\nbreak", "cr\rinside", "a  b"),
    *("it's", '"quoted"', "`back`", "$(reboot)", "${HOME}", "%s%n", "a;b", "a|b", "a&b", "a&&b"),
    *("&lt;", "&#0;", "<b>", "</name>", "]]>", "<!--", "<!DOCTYPE x>", "<?xml?>", "a=b", "[1]"),
    *("' or '1'='1", "') or true() or ('", "a/b", "a//b", "/", "//", "/abs", "a/", "../../x"),
    *("..", ".", "a.b", "C:\\x", "\\", "~", "~/private", "{node}", "{ns}", "a:=b", "__node"),
    *("_", "__", "___", "a_", "a__b", "_a", "a_b", "-", "--", "a-b", "+", "*", "#", "@", "!", "?"),
    # What the node's own names, escapes and topics look like.
    *("biosensors", "diagnostics", "rosout", "parameter_events", "clock", "lsl_to_ros", "node"),
    *("x_chunk", "x_stamped", "x_imu", "x_mag", "bat_state", "x_temperature", "_chunk", "chunk"),
    *("polar_h10", "polar_h10_left", "zephyr", "p01", "gateway", "x0", "x0a", "_x20", "a_x20b"),
    *("x0_x20", "_x2F", "x2F", "a_x5Fchunk", "a_x68b", "a_x75b", "x_X2F", "a_x2f", "data", "Data"),
    # Reserved words, numbers, and letters of one case only.
    *("int", "class", "string", "null", "None", "true", "NaN", "namespace", "con", "nul", "CON"),
    *("0", "1st", "42", "0x10", "1e5", "-1", "EEG", "eeg", "Eeg", "i", "I", "ss", "SS"),
    # More than ASCII: accents both ways, width, direction, emoji, and beyond the first plane.
    *("é", "e\u0301", "ü", "\N{OHM SIGN}", "\N{GREEK CAPITAL LETTER OMEGA}", "脳波", "心電図"),
    *("сердце", "قلب", "\uff25\uff25\uff27", "ﬁ", "a\u200bb", "\u0130", "\u0131", "ß"),
    *("\u202eabc", "\ufeffbom", "a\u00a0b", "\N{PILE OF POO}", "\U0001d54f", "\U0010fffd", "\x7f"),
    # Control characters. LSL turns a carriage return into a line feed.
    *(f"a{chr(code)}b" for code in range(1, 32) if chr(code) not in "\n\r"),
    # Lengths at and around the limit of a token, and far beyond it.
    *("x" * length for length in (1, 63, 64, 65, 200, 255, 256, 5000)),
    *("x" * 63 + "y", "x" * 64 + "y", "x" * 65 + "y", "x" * 4999 + "y", "_" * 64, "a" + " " * 300),
    *("é" * 32, "é" * 33, "é" * 2500, "/" * 5000, "x" * 60 + "_chunk", "x" * 60 + "_stamped"),
]
# An empty name, or one of blanks alone, LSL refuses itself; an empty type it does not.
BLANK = ["", " ", " " * 300, "\n"]


class Claim(NamedTuple):
    """What a stream calls itself."""

    name: str
    kind: str
    rate: float
    format: str

    def open(self, source_id: str) -> pylsl.StreamOutlet:
        info = pylsl.StreamInfo(self.name, self.kind, 1, self.rate, self.format, source_id)
        return pylsl.StreamOutlet(info)


def waves() -> list[list[Claim]]:
    """Every hostile text as a name, as a type, and each with another one."""
    types = [*BLANK, *HOSTILE]
    groups = [
        [Claim(text, "EEG", 100.0, "float32") for text in HOSTILE],
        [Claim(f"typed {place}", text, 100.0, "float32") for place, text in enumerate(types)],
        [Claim(*pair, 0.0, "string") for pair in zip(HOSTILE[::3], HOSTILE[1::3], strict=False)],
    ]
    return [group[start : start + WAVE] for group in groups for start in range(0, len(group), WAVE)]


class Wave:
    """Streams with hostile names, and the topics that the node gives them."""

    def __init__(self, claims: list[Claim], numbers: count[int]) -> None:
        self.claims = {f"hostile {next(numbers)}": claim for claim in claims}
        self.outlets = {key: claim.open(key) for key, claim in self.claims.items()}

    def close(self) -> None:
        # Each waits for liblsl's threads.
        with ThreadPoolExecutor(len(self.outlets)) as pool:
            pool.map(self.outlets.__delitem__, list(self.outlets))

    def topics(self, lists: list[Any]) -> dict[str, list[str]]:
        """Topics by source_id, as far as they are in the latest list."""
        entries = [{one.key: one.value for one in status.values} for status in lists[-1].status]
        return {
            entry["source_id"]: [
                key.removeprefix("topic ") for key in entry if key.startswith("topic ")
            ]
            for entry in entries
            if entry["source_id"] in self.claims
        }


@pytest.mark.usefixtures("node")
def test_a_name_that_lsl_cannot_carry_harms_no_other_stream(ros: Ros, node: RunningNode) -> None:
    nameless = pylsl.StreamOutlet(pylsl.StreamInfo(" ", "EEG", 1, 0.0, "float32", "nameless"))
    ros.until(lambda: node.count("[WARN]", "ignored", "invalid") > 0, "a sentence about it")
    good = pylsl.StreamOutlet(pylsl.StreamInfo("named", "EEG", 1, 0.0, "float32", "named"))
    heard = ros.listen(Float32MultiArray, "/biosensors/named/EEG")
    ros.attached("/biosensors/named/EEG", readers=1)
    good.push_sample([1.0], pylsl.local_clock())
    ros.until(lambda: bool(heard), "a sample of another stream")
    del nameless


@pytest.mark.usefixtures("node")
def test_every_name_and_type_gives_valid_topics_of_its_own(ros: Ros) -> None:
    lists = ros.listen(DiagnosticArray, STREAMS, LATCHED)
    ros.until(lambda: bool(lists), "the list of streams")
    numbers, taken = count(), set[str]()
    for claims in waves():
        wave = Wave(claims, numbers)
        ros.until(
            lambda wave=wave: wave.topics(lists).keys() == wave.claims.keys(), "the whole wave"
        )
        topics = wave.topics(lists)
        for key, names in topics.items():
            assert len(names) == (2 if wave.claims[key].rate else 1)
            for name in names:
                assert validate_full_topic_name(name)
                assert name.startswith("/biosensors/")
                assert name.count("/") == 3
                assert name not in taken, wave.claims[key]
                taken.add(name)
        check_flow(ros, wave, topics)
        wave.close()
        ros.until(lambda wave=wave: not wave.topics(lists), "the end of the wave")
    assert next(numbers) >= 400
    assert len(taken) > 700


def check_flow(ros: Ros, wave: Wave, topics: dict[str, list[str]]) -> None:
    """Push through some streams of a wave, evenly chosen."""
    chosen = list(topics)[:: len(topics) // SUBSCRIBED + 1]
    kinds = {"float32": Float32MultiArray, "string": String}
    heard = {key: ros.listen(kinds[wave.claims[key].format], topics[key][0]) for key in chosen}

    def all_flow() -> bool:
        for number, key in enumerate(chosen):
            value = number if wave.claims[key].format == "float32" else str(number)
            wave.outlets[key].push_sample([value], pylsl.local_clock())
        return all(heard.values())

    ros.until(all_flow, "samples under hostile names")
    for number, messages in enumerate(heard.values()):
        data = messages[0].data
        assert (data if isinstance(data, str) else data[0]) in (number, str(number))


# Several devices of one kind, and streams that claim to be the same one.
def declared(sensor_name: str, data: str, unit: str, who: str = "", label: str = "") -> Outlet:
    identity = DeviceIdentity(sensor_name, unit, participant=who, label=label)
    return Outlet(declaration(sensor_name).stream(data), identity, DeviceInfo())


def foreign(name: str, kind: str, channels: int, source_id: str) -> pylsl.StreamOutlet:
    return pylsl.StreamOutlet(pylsl.StreamInfo(name, kind, channels, 0.0, "float32", source_id))


def numbers(messages: list[Any]) -> set[float]:
    return {message.data for message in messages}


def flow(ros: Ros, outlet: Outlet, value: float, arrived: Callable[[], bool]) -> int:
    """Push one value until it arrives; return how often it was pushed."""
    pushes = count()

    def push_and_look() -> bool:
        if arrived():
            return True
        next(pushes)
        assert outlet.push([value], [pylsl.local_clock()]) is None
        return False

    ros.until(push_and_look, f"{value} on its topic")
    return next(pushes)


@pytest.mark.usefixtures("node")
def test_a_replaced_device_continues_the_stream_of_its_place(ros: Ros) -> None:
    topic = "/p09/biosensors/polar_h10_chest/hr"
    heard = ros.listen(Float32, topic)
    for unit, value in (("OLD", 61.0), ("NEW", 62.0)):
        outlet = declared("polar_h10", "hr", unit, who="p09", label="chest")
        flow(ros, outlet, value, lambda value=value: value in numbers(heard))
        ros.report()
        status = ros.status(topic)
        assert status is not None
        assert (status.level, status.unit) == (DiagnosticStatus.OK, unit)
        del outlet
    assert numbers(heard) == {61.0, 62.0}


@pytest.mark.usefixtures("node")
def test_streams_of_one_program_may_share_a_source_id(ros: Ros) -> None:
    kinds = ("EEG", "PPG", "ACC")
    heard = {kind: ros.listen(Float32MultiArray, f"/biosensors/headband/{kind}") for kind in kinds}
    outlets = {kind: foreign("headband", kind, 1, "headband 00:11") for kind in kinds}
    ros.attached(*(f"/biosensors/headband/{kind}" for kind in kinds), readers=1)
    for number, kind in enumerate(kinds):
        outlets[kind].push_sample([float(number)], pylsl.local_clock())
    ros.until(lambda: all(heard.values()), "a sample of each")
    assert [heard[kind][0].data[0] for kind in kinds] == [0.0, 1.0, 2.0]


@pytest.mark.usefixtures("node")
def test_each_of_several_streams_that_claim_to_be_one_has_a_topic(
    ros: Ros, node: RunningNode
) -> None:
    topics = [f"/biosensors/twin/EEG{end}" for end in ("", "_2", "_3")]
    heard = [ros.listen(Float32MultiArray, topic) for topic in topics]
    outlets: list[pylsl.StreamOutlet] = []

    def each_arrives() -> bool:
        for number, outlet in enumerate(outlets):
            outlet.push_sample([float(number)], pylsl.local_clock())
        return all(heard[: len(outlets)])

    for _ in topics:
        # One after the other, so that each has the next number.
        outlets.append(foreign("twin", "EEG", 1, "twin id"))
        ros.until(each_arrives, "a sample of each")
    assert [{message.data[0] for message in each} for each in heard] == [{0.0}, {1.0}, {2.0}]

    def are_told() -> bool:
        told = [ros.status(topic) for topic in topics]
        return all(
            each is not None
            and each.level == DiagnosticStatus.WARN
            and "3 senders have the same source_id" in each.message
            for each in told
        )

    ros.until(are_told, "a warning of each topic")


VALUES = {"A": 1.0, "B": 2.0}
# A capital starts the unit of that name, a small letter stops it.
ORDERS = [
    ("AB", "polar_h10", "ibi"),
    ("BA", "zephyr", "ibi"),
    ("AaB", "shimmer3_gsr", "hr"),
    ("ABaA", "empatica_e4", "ibi"),
    ("ABabBA", "ble_heart_rate", "ibi"),
]


class Pair:
    """Two units of one sensor without labels, started and stopped in some order."""

    def __init__(self, ros: Ros, steps: str, name: str, data: str) -> None:
        self.steps = steps
        self.bare = f"/biosensors/{name}/{data}"
        self.own = {unit: f"/biosensors/{name}_{unit}/{data}" for unit in VALUES}
        self.heard = {
            topic: ros.listen(Float32, topic) for topic in (self.bare, *self.own.values())
        }
        self.running: dict[str, Outlet] = {}
        self._name, self._data = name, data

    def begin(self, number: int) -> None:
        step = self.steps[number : number + 1]
        if step.isupper():
            self.running[step] = declared(self._name, self._data, step)
        elif step:
            del self.running[step.upper()]
        self.topics = {unit: self.own[unit] if number else self.bare for unit in self.running}
        for topic in self.topics.values():
            self.heard[topic].clear()

    def is_done(self, present: set[str]) -> bool:
        """Whether the present units, and no others, are on their topics."""
        for unit, outlet in self.running.items():
            assert outlet.push([VALUES[unit]], [pylsl.local_clock()]) is None
        mine = {self.bare, *self.own.values()} & present
        return mine == set(self.topics.values()) and all(map(self.heard.get, mine))


@pytest.mark.usefixtures("node")
def test_data_of_one_unit_never_appears_under_the_topic_of_another(ros: Ros) -> None:
    pairs = [Pair(ros, *order) for order in ORDERS]
    for number in range(max(len(pair.steps) for pair in pairs)):
        for pair in pairs:
            pair.begin(number)
        ros.until(
            lambda: all(pair.is_done(ros.present()) for pair in pairs), f"step {number} of each"
        )
    for pair in pairs:
        ros.until(lambda bare=pair.bare: ros.node.count_publishers(bare) == 0, "its end")
        assert numbers(pair.heard[pair.bare]) == {VALUES[pair.steps[0]]}
        for unit, topic in pair.own.items():
            assert numbers(pair.heard[topic]) <= {VALUES[unit]}
        for unit in pair.running:
            status = ros.status(pair.own[unit])
            assert status is not None
            assert status.level == DiagnosticStatus.ERROR
            assert "label" in status.message


@pytest.mark.usefixtures("node")
@pytest.mark.seam
def test_labels_and_participants_keep_devices_of_a_kind_apart(ros: Ros) -> None:
    places = [("", "left"), ("", "right"), ("p01", ""), ("p02", ""), ("p01", "left")]
    topics = [
        "/biosensors/empatica_e4_left/hr",
        "/biosensors/empatica_e4_right/hr",
        "/p01/biosensors/empatica_e4/hr",
        "/p02/biosensors/empatica_e4/hr",
        "/p01/biosensors/empatica_e4_left/hr",
    ]
    outlets = [
        declared("empatica_e4", "hr", f"U{number}", who, label)
        for number, (who, label) in enumerate(places)
    ]
    heard = [ros.listen(Float32, topic) for topic in topics]
    for number, outlet in enumerate(outlets):
        flow(ros, outlet, float(number), lambda number=number: bool(heard[number]))
    ros.report()
    for number, topic in enumerate(topics):
        assert numbers(heard[number]) == {float(number)}
        status = ros.status(topic)
        assert status is not None
        assert status.level == DiagnosticStatus.OK
