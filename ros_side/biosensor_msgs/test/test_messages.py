"""The messages keep what is put into them; run by ``colcon test``."""

import math

from biosensor_msgs.msg import Event, Samples
from rclpy.serialization import deserialize_message, serialize_message


def test_samples_keep_values_times_and_counts():
    sent = Samples(
        sequence=2**63,
        lost=-1,
        lost_is_estimated=True,
        labels=["x", "y"],
        units=["mg", ""],
        offsets_ns=[0, 31_250_000],
        data=[1.5, math.nan, -math.inf, 0.0],
    )
    sent.header.stamp.sec = 7
    sent.header.frame_id = "acme_band"
    got = deserialize_message(serialize_message(sent), Samples)
    # NaN is "no value", so it must not become a number.
    assert [math.isnan(each) for each in got.data] == [False, True, False, False]
    assert str(got) == str(sent)


def test_integers_of_64_bits_keep_every_bit():
    sent = Samples(integers=[2**63 - 1, -(2**63)])
    got = deserialize_message(serialize_message(sent), Samples)
    assert list(got.integers) == [2**63 - 1, -(2**63)]
    assert not got.data


def test_an_event_keeps_its_text():
    sent = Event(sequence=3, data='["\u00e4", "b"]')
    got = deserialize_message(serialize_message(sent), Event)
    assert (got.sequence, got.data) == (3, sent.data)
