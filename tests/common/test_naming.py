import re
from itertools import product

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity

Claim = tuple[DeviceIdentity, str]

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
texts = st.one_of(dense, st.text(st.characters(exclude_categories=())), st.sampled_from(HOSTILE))
tight = st.sampled_from(("", "a", "b", "a_b", "b_a", "a-b", "_", "x0", "zephyr", "zephyr_a"))
identities = st.builds(DeviceIdentity, sensor=texts, unit=texts, participant=texts, label=texts)
close_identities = st.builds(
    DeviceIdentity, sensor=tight, unit=tight, participant=st.sampled_from(("", "a")), label=tight
)
claims = st.tuples(st.one_of(identities, close_identities), texts)


def unsanitise(token: str) -> str:
    """Read a token that was not cut."""
    escaped = token.removeprefix("x0")
    pieces = re.findall(r"_x([0-9A-F]{2})|(.)", escaped)
    data = b"".join(bytes.fromhex(code) if code else char.encode() for code, char in pieces)
    return data.decode("utf-8", "surrogatepass")


class TestSanitise:
    @given(texts)
    @example("a" * 64)
    @example("a" * 65)
    @example("é" * 300)
    def test_gives_a_valid_token(self, text: str) -> None:
        token = naming.sanitise(text)
        assert TOKEN.fullmatch(token)
        assert len(token) <= 64

    @given(texts)
    def test_can_be_undone(self, text: str) -> None:
        token = naming.sanitise(text)
        if "_x68" not in token:
            assert unsanitise(token) == text

    @given(texts, texts)
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
