from collections import Counter
from collections.abc import Callable
from itertools import permutations
from random import Random

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.devices.registry import declaration_names

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
