"""Names of streams and topics, and those of the original framework, which never change."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from itertools import permutations, product
from random import Random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.devices.registry import declaration, declaration_names

Claim = tuple[DeviceIdentity, str]
LEFT = DeviceIdentity("empatica_e4", "A1", "", "left")
ONE = DeviceIdentity("zephyr", "B1")
TWO = DeviceIdentity("zephyr", "B2")
OTHER_PERSON = DeviceIdentity("zephyr", "B3", "p02")
texts = st.one_of(
    st.text(alphabet="ab_x0257F68 -/é\ud800", max_size=8),
    st.text(st.characters(exclude_categories=())),
)
# Few values, so that names meet often.
tight = st.sampled_from(("", "a", "b", "a_b", "b_a", "a-b", "_", "x0", "zephyr", "zephyr_a"))
identities = st.builds(DeviceIdentity, sensor=texts, unit=texts, participant=texts, label=texts)
close_identities = st.builds(
    DeviceIdentity, sensor=tight, unit=tight, participant=st.sampled_from(("", "a")), label=tight
)
streams_near_and_far = st.lists(
    st.one_of(st.tuples(identities, texts), st.tuples(close_identities, tight)), max_size=12
)


def keyed(*streams: Claim) -> dict[int, Claim]:
    return dict(enumerate(streams))


def names(topics: dict[int, naming.TopicName]) -> list[str]:
    return [topics[key].name for key in sorted(topics)]


class TestTopics:
    @pytest.mark.parametrize(
        ("identity", "by_unit", "expected"),
        [
            (DeviceIdentity("polar_h10", "C1"), False, "biosensors/polar_h10/hr"),
            (DeviceIdentity("polar_h10", "C1"), True, "biosensors/polar_h10_C1/hr"),
            (DeviceIdentity("polar_h10", "C1", "p01"), False, "p01/biosensors/polar_h10/hr"),
            (
                DeviceIdentity("empatica_e4", "C1", "", "left"),
                False,
                "biosensors/empatica_e4_left/hr",
            ),
            (
                DeviceIdentity("zephyr", "B1", "p01", "left"),
                True,
                "p01/biosensors/zephyr_left_B1/hr",
            ),
            (DeviceIdentity("polar_h10", "C1", "", "2"), False, "biosensors/polar_h10_2/hr"),
        ],
    )
    def test_follow_the_pattern(
        self, identity: DeviceIdentity, by_unit: bool, expected: str
    ) -> None:
        assert naming.topic(identity, "hr", by_unit=by_unit) == expected

    def test_prefix_may_be_nested_or_empty(self) -> None:
        identity = DeviceIdentity("polar_h10", "C1", "p01")
        assert naming.topic(identity, "hr", "lab/bio") == "p01/lab/bio/polar_h10/hr"
        assert naming.topic(identity, "hr", "") == "p01/polar_h10/hr"

    @given(identities, texts, st.booleans())
    @example(DeviceIdentity("s" * 300, "u" * 300, "p" * 300, "l" * 300), "d" * 300, True)
    def test_are_valid_in_ros_with_every_suffix(
        self, ros_accepts: Callable[[str], bool], identity: DeviceIdentity, data: str, by_unit: bool
    ) -> None:
        name = naming.topic(identity, data, by_unit=by_unit)
        assert ros_accepts(name)
        assert ros_accepts(f"{name}_chunk")
        assert ros_accepts(f"{name}_stamped")

    @given(texts, texts)
    @example("eeg", "eeg_chunk")
    @example("eeg_x5Fchunk", "eeg_chunk")
    def test_of_two_data_names_never_meet_even_with_suffixes(self, one: str, other: str) -> None:
        identity = DeviceIdentity("OpenBCI", "x")
        suffixes = ("", "_chunk", "_stamped")
        taken = [
            naming.topic(identity, data_name) + suffix
            for data_name in {one, other}
            for suffix in suffixes
        ]
        assert len(set(taken)) == len(taken)

    @given(
        st.lists(
            st.builds(
                DeviceIdentity,
                sensor=st.sampled_from(declaration_names()),
                unit=st.just(""),
                label=texts.filter(lambda text: len(text) < 8),
            ),
            max_size=20,
            unique=True,
        )
    )
    def test_tell_declared_sensors_and_labels_apart(self, devices: list[DeviceIdentity]) -> None:
        assert len({naming.sensor_topic_name(device) for device in devices}) == len(devices)


class TestForeignStreams:
    def test_are_named_by_what_they_say(self) -> None:
        identity, data_name = naming.foreign_identity("OpenBCI EEG", "EEG", "board-7", "labpc")
        assert identity == DeviceIdentity("OpenBCI EEG", "board-7")
        assert naming.topic(identity, data_name) == "biosensors/OpenBCI_x20EEG/EEG"

    def test_without_source_id_are_told_apart_by_host(self) -> None:
        identity, _ = naming.foreign_identity("Mouse", "Position", "", "labpc")
        assert identity.unit == "labpc"

    def test_without_type_carry_data(self) -> None:
        _, data_name = naming.foreign_identity("Mouse", "", "", "labpc")
        assert data_name == "data"

    @pytest.mark.parametrize("suffix", ["chunk", "stamped"])
    def test_cannot_take_a_topic_that_is_made_from_another(self, suffix: str) -> None:
        identity, data_name = naming.foreign_identity("Muse", f"EEG_{suffix}", "m", "labpc")
        assert naming.topic(identity, data_name) == f"biosensors/Muse/EEG_x5F{suffix}"


class TestResolveTopics:
    def test_one_of_a_kind_keeps_the_plain_name(self) -> None:
        topics = naming.resolve_topics(
            keyed((ONE, "ecg"), (ONE, "hr"), (LEFT, "bvp"), (OTHER_PERSON, "ecg"))
        )
        assert names(topics) == [
            "biosensors/zephyr/ecg",
            "biosensors/zephyr/hr",
            "biosensors/empatica_e4_left/bvp",
            "p02/biosensors/zephyr/ecg",
        ]
        assert not any(topic.conflict or topic.duplicate for topic in topics.values())

    def test_two_of_a_kind_both_carry_their_unit_on_every_stream(self) -> None:
        topics = naming.resolve_topics(
            keyed((ONE, "ecg"), (ONE, "hr"), (TWO, "ecg"), (OTHER_PERSON, "ecg"))
        )
        assert names(topics) == [
            "biosensors/zephyr_B1/ecg",
            "biosensors/zephyr_B1/hr",
            "biosensors/zephyr_B2/ecg",
            "p02/biosensors/zephyr/ecg",
        ]
        assert [topics[key].conflict for key in range(4)] == [True, True, True, False]

    def test_a_label_ends_the_conflict(self) -> None:
        labelled = DeviceIdentity("zephyr", "B2", "", "back")
        topics = naming.resolve_topics(keyed((ONE, "ecg"), (labelled, "ecg")))
        assert names(topics) == ["biosensors/zephyr/ecg", "biosensors/zephyr_back/ecg"]

    def test_the_base_holds_all_topics_of_a_device(self) -> None:
        topic = naming.resolve_topics(keyed((ONE, "breathing")), "lab")[0]
        assert (topic.base, topic.data) == ("lab/zephyr", "breathing")

    def test_a_device_that_left_keeps_its_name_closed(self) -> None:
        topics = naming.resolve_topics(keyed((TWO, "ecg")), gone=[ONE])
        assert names(topics) == ["biosensors/zephyr_B2/ecg"]

    def test_a_device_that_came_back_is_no_conflict(self) -> None:
        topics = naming.resolve_topics(keyed((ONE, "ecg")), gone=[ONE])
        assert names(topics) == ["biosensors/zephyr/ecg"]

    def test_two_outlets_that_claim_one_stream_are_duplicates(self) -> None:
        topics = naming.resolve_topics(keyed((ONE, "ecg"), (ONE, "ecg"), (ONE, "hr")))
        assert [topics[key].duplicate for key in range(3)] == [True, True, False]
        assert topics[0] == topics[1]
        assert not topics[0].conflict

    def test_a_foreign_stream_named_like_a_labelled_sensor_meets_no_one(self) -> None:
        foreign = naming.foreign_identity("empatica_e4_left", "bvp", "spoof", "labpc")
        topics = naming.resolve_topics(keyed((LEFT, "bvp"), foreign))
        assert names(topics) == [
            "biosensors/empatica_e4_left_A1/bvp",
            "biosensors/empatica_e4_left_spoof/bvp",
        ]

    def test_a_name_with_unit_that_a_label_already_has_is_avoided(self) -> None:
        squatter = DeviceIdentity("zephyr", "B9", "", "B1")
        topics = naming.resolve_topics(keyed((ONE, "ecg"), (TWO, "ecg"), (squatter, "ecg")))
        assert names(topics) == [
            "biosensors/zephyr_x75_x75B1/ecg",
            "biosensors/zephyr_B2/ecg",
            "biosensors/zephyr_B1_B9/ecg",
        ]

    def test_a_name_that_was_too_short_for_others_stays_closed(self) -> None:
        squatters = [DeviceIdentity("zephyr", unit, "", "B1") for unit in ("C1", "C2")]
        topics = naming.resolve_topics(keyed(*((d, "ecg") for d in (ONE, TWO, *squatters))))
        assert names(topics) == [
            "biosensors/zephyr_x75_x75B1/ecg",
            "biosensors/zephyr_B2/ecg",
            "biosensors/zephyr_B1_C1/ecg",
            "biosensors/zephyr_B1_C2/ecg",
        ]

    def test_every_order_of_coming_and_going_gives_the_same_names(self) -> None:
        devices = [ONE, TWO, LEFT, OTHER_PERSON, DeviceIdentity("zephyr", "B9", "", "B1")]
        streams = {device.unit: (device, "ecg") for device in devices}
        expected = naming.resolve_topics(streams)
        for order in permutations(streams):
            present = {unit: streams[unit] for unit in order}
            assert naming.resolve_topics(present) == expected

    @given(st.lists(st.tuples(close_identities, tight), max_size=12), st.randoms())
    def test_order_never_matters(self, streams: list[Claim], random: Random) -> None:
        items = list(keyed(*streams).items())
        expected = naming.resolve_topics(dict(items))
        random.shuffle(items)
        assert naming.resolve_topics(dict(items)) == expected

    @given(streams_near_and_far)
    def test_two_streams_share_a_topic_only_as_duplicates(self, streams: list[Claim]) -> None:
        topics = naming.resolve_topics(keyed(*streams))
        count = Counter(streams)
        by_name: dict[str, set[Claim]] = {}
        for key, stream in enumerate(streams):
            by_name.setdefault(topics[key].name, set()).add(stream)
            assert topics[key].duplicate == (count[stream] > 1)
        assert all(len(claimants) == 1 for claimants in by_name.values())

    @given(st.lists(close_identities, max_size=8, unique=True), close_identities)
    def test_a_newcomer_never_gets_a_topic_that_another_had(
        self, devices: list[DeviceIdentity], newcomer: DeviceIdentity
    ) -> None:
        before = naming.resolve_topics({device: (device, "hr") for device in devices})
        after = naming.resolve_topics({newcomer: (newcomer, "hr")}, gone=devices)
        had = {topic.name for device, topic in before.items() if device != newcomer}
        assert after[newcomer].name not in had

    @given(streams_near_and_far)
    def test_every_name_is_valid_in_ros(
        self, ros_accepts: Callable[[str], bool], streams: list[Claim]
    ) -> None:
        topics = naming.resolve_topics(keyed(*streams))
        assert all(ros_accepts(f"{topic.name}_stamped") for topic in topics.values())


TOKEN = re.compile(r"[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)*")
ORDINARY = re.compile(r"(?!x0)[A-Za-z][A-Za-z0-9]*(?:_(?!x[0-9A-F]{2})[A-Za-z0-9]+)*")
HOSTILE = (
    "",
    "_",
    "__",
    "a__b",
    "a_",
    "_a",
    "a b",
    "a_x20b",
    "a_x5Fx20b",
    "x0",
    "x0x0",
    "x01",
    "1",
    "00:06:66:F2:AF:E9",
    "/dev/ttyUSB0",
    "~",
    "..",
    "a-b",
    "a@b.c",
    "'\"",
    "a\nb",
    "\0",
    "é",
    "e\u0301",
    "脳波",
    "🫀",
    "\ud800",
    "\ud83e\udec0",
    "eeg_chunk",
    "eeg_x5Fchunk",
    "eeg_stamped",
)
# Few characters that matter, so that near misses are common.
dense = st.text(alphabet="ab_x025FAx68 -.@é\ud800", max_size=8)
names_of_people = st.one_of(
    dense, st.text(st.characters(exclude_categories=())), st.sampled_from(HOSTILE)
)
named_identities = st.builds(
    DeviceIdentity,
    sensor=names_of_people,
    unit=names_of_people,
    participant=names_of_people,
    label=names_of_people,
)
claims = st.tuples(st.one_of(named_identities, close_identities), names_of_people)


def unsanitise(token: str) -> str:
    """Read a token that was not cut."""
    escaped = token.removeprefix("x0")
    pieces = re.findall(r"_x([0-9A-F]{2})|(.)", escaped)
    data = b"".join(bytes.fromhex(code) if code else char.encode() for code, char in pieces)
    return data.decode("utf-8", "surrogatepass")


class TestSanitise:
    @given(names_of_people)
    @example("a" * 64)
    @example("a" * 65)
    @example("é" * 300)
    def test_gives_a_valid_token(self, text: str) -> None:
        token = naming.sanitise(text)
        assert TOKEN.fullmatch(token)
        assert len(token) <= 64

    @given(names_of_people)
    def test_can_be_undone(self, text: str) -> None:
        token = naming.sanitise(text)
        if "_x68" not in token:
            assert unsanitise(token) == text

    @given(names_of_people, names_of_people)
    def test_keeps_different_texts_apart(self, one: str, other: str) -> None:
        assert (naming.sanitise(one) == naming.sanitise(other)) == (one == other)

    def test_keeps_every_short_text_apart(self) -> None:
        alphabet = ("a", "_", "x", "0", "5", "F", "-")
        texts_ = ["".join(chars) for size in range(7) for chars in product(alphabet, repeat=size)]
        assert len({naming.sanitise(text) for text in texts_}) == len(texts_)

    @given(st.from_regex(ORDINARY, fullmatch=True).filter(lambda text: len(text) <= 64))
    @example("polar_h10")
    @example("AF3")
    @example("a_1")
    @example("a_xab")
    def test_leaves_ordinary_names_alone(self, name: str) -> None:
        assert naming.sanitise(name) == name

    @pytest.mark.parametrize(
        ("text", "token"),
        [
            ("", "x0"),
            ("1", "x01"),
            ("x0", "x0x0"),
            ("a b", "a_x20b"),
            ("a__b", "a_x5F_x5Fb"),
            ("a_", "a_x5F"),
            ("_a", "x0_x5Fa"),
            ("a_x20b", "a_x5Fx20b"),
            ("é", "x0_xC3_xA9"),
            ("\ud800", "x0_xED_xA0_x80"),
        ],
    )
    def test_escapes_bytes(self, text: str, token: str) -> None:
        assert naming.sanitise(text) == token

    def test_long_texts_differ_by_a_hash_that_no_short_text_can_imitate(self) -> None:
        one, other = naming.sanitise("a" * 200), naming.sanitise("a" * 201)
        assert one != other
        assert one.startswith("a" * 44 + "_x68")
        assert naming.sanitise(one) != one

    def test_is_stable(self) -> None:
        # Recordings and launch files hold such names: a new version must not change them.
        assert naming.sanitise("a" * 65) == "a" * 44 + "_x68635361c48bb9eab1"


class TestLslNames:
    @given(claims, claims)
    def test_tell_all_fields_apart(self, one: Claim, other: Claim) -> None:
        assert (naming.lsl_name(*one) == naming.lsl_name(*other)) == (one == other)

    @given(st.lists(st.tuples(close_identities, tight), min_size=2, max_size=40, unique=True))
    def test_tell_similar_fields_apart(self, streams: list[Claim]) -> None:
        assert len({naming.lsl_name(*stream) for stream in streams}) == len(streams)

    @given(claims)
    def test_are_plain_ascii(self, stream: Claim) -> None:
        assert re.fullmatch(r"[A-Za-z0-9_-]+", naming.lsl_name(*stream))

    @pytest.mark.parametrize(
        ("identity", "name"),
        [
            (DeviceIdentity("zephyr", "BHT012345"), "zephyr-BHT012345-ecg"),
            (DeviceIdentity("zephyr", "BHT012345", "p01"), "p01-zephyr-BHT012345-ecg"),
            (DeviceIdentity("zephyr", "B1", "", "left"), "zephyr__left-B1-ecg"),
            (DeviceIdentity("zephyr", "B1", "p01", "left"), "p01-zephyr__left-B1-ecg"),
            (DeviceIdentity("shimmer3_gsr", "000666F2AFE9"), "shimmer3_gsr-000666F2AFE9-ecg"),
        ],
    )
    def test_are_readable(self, identity: DeviceIdentity, name: str) -> None:
        assert naming.lsl_name(identity, "ecg") == name


def place(stream: Claim) -> tuple[str, ...]:
    """What a source id stands for: the place on the body, else the device."""
    identity, data_name = stream
    if identity.participant or identity.label:
        return ("place", identity.participant, identity.sensor, identity.label, data_name)
    return ("device", identity.sensor, identity.unit, data_name)


class TestSourceIds:
    @given(claims, claims)
    def test_differ_exactly_where_the_place_does(self, one: Claim, other: Claim) -> None:
        same = naming.source_id(*one) == naming.source_id(*other)
        assert same == (place(one) == place(other))

    @given(st.lists(st.tuples(close_identities, tight), max_size=40))
    def test_tell_similar_places_apart(self, streams: list[Claim]) -> None:
        ids = {naming.source_id(*stream) for stream in streams}
        assert len(ids) == len({place(stream) for stream in streams})

    @given(claims)
    def test_hold_neither_quotes_nor_blanks(self, stream: Claim) -> None:
        assert re.fullmatch(r"[A-Za-z0-9_@.-]+", naming.source_id(*stream))

    @pytest.mark.parametrize(
        ("identity", "expected"),
        [
            (DeviceIdentity("zephyr", "BHT012345"), "zephyr-BHT012345-ecg"),
            (DeviceIdentity("zephyr", "BHT012345", "p01"), "p01@zephyr-ecg"),
            (DeviceIdentity("zephyr", "BHT012345", "", "left"), "zephyr.left-ecg"),
            (DeviceIdentity("zephyr", "BHT012345", "p01", "left"), "p01@zephyr.left-ecg"),
        ],
    )
    def test_are_readable(self, identity: DeviceIdentity, expected: str) -> None:
        assert naming.source_id(identity, "ecg") == expected


# The topics of the original framework, whose names and types never change.
def test_contract_topics_have_the_originals_names_and_types() -> None:
    """The node publishes what the declarations say."""
    contract = {
        f"{name}/{stream.data_name}": stream.message_type.value.rpartition("/")[2]
        for name in declaration_names()
        for stream in declaration(name).streams
        if stream.contract
    }
    assert contract == {
        "empatica_e4/bvp": "Float32",
        "empatica_e4/gsr": "Float32",
        "empatica_e4/st": "Float32",
        "empatica_e4/hr": "Float32",
        "empatica_e4/ibi": "Float32",
        "empatica_e4/acc": "Float32MultiArray",
        "empatica_e4/bat": "Float32",
        "empatica_e4/tag": "Empty",
        "emotiv_insight/eeg": "Float32MultiArray",
        "emotiv_insight/pow": "Float32MultiArray",
        "emotiv_insight/met": "Float32MultiArray",
        "emotiv_insight/mot": "Float32MultiArray",
        "emotiv_insight/dev": "Float32MultiArray",
        "shimmer3_gsr/gsr": "Float32",
        "shimmer3_gsr/ppg": "Float32",
        "polar_h10/hr": "Float32",
        "vernier_respiration_belt/bpm": "Float32",
        "vernier_respiration_belt/force": "Float32",
        "zephyr/hr": "UInt8",
        "zephyr/hrv": "UInt16",
        "zephyr/br": "Float32",
    }
