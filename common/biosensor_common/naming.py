"""Builds LSL names, source ids and ROS topic names.

Every name is built from fields that people and other programs choose, so each
is escaped: what ROS or LSL forbids becomes ``_xHH``, one for each UTF-8 byte.
Two different fields never give one token, and ordinary ones stay as they are.

A topic's sensor part, ``<sensor>[_<label>]``, is read by people and therefore
plain. It tells all pairs apart as long as no sensor is named like another one
plus a label, which holds for the built-in sensors. Where it does not hold (a
stream of another program called ``zephyr_left``) and where two devices of a kind
meet, :func:`resolve_topics` moves all of them to longer names.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import TypeVar

from biosensor_common.known_senders import known_stream
from biosensor_common.spec import DeviceIdentity

# What stays: letters, digits, and an underscore between two of them that does
# not look like the start of an escape.
_FORBIDDEN = re.compile(
    r"(?:(?<![A-Za-z0-9])_|_(?![A-Za-z0-9])|_(?=x[0-9A-F]{2})|[^A-Za-z0-9_])", re.DOTALL
)
_MARKER = "x0"
_TAKEN_SUFFIX = re.compile(r"_(chunk|stamped)\Z")
_TOKEN_LENGTH = 64
_HASH_LENGTH = 16
# Escaped letters: no field contains them, because letters stay as they are.
_HASH_MARK = "_x68"
_FIELD_MARK = "_x75"

Key = TypeVar("Key", bound=Hashable)

AGENT = "gateway"
"""Sensor of an agent's own streams; its unit is the computer, so there are as many as computers."""
NODE = "lsl_to_ros"
"""Sensor of a node's own streams; its unit is the computer, too."""


@dataclass(frozen=True, slots=True)
class TopicName:
    """Where one stream is published.

    Attributes
    ----------
    base
        Relative name of the sensor, ``[<participant>/]<prefix>/<sensor>``; the
        device's other topics are beside it.
    data
        Last part of the name.
    conflict
        Another device would have had the same base: both carry their unit.
    duplicate
        Another stream claims to be this one, of the same device.
    """

    base: str
    data: str
    conflict: bool = False
    duplicate: bool = False

    @property
    def name(self) -> str:
        """The relative topic name."""
        return f"{self.base}/{self.data}"

    def frame_id(self, prefix: str) -> str:
        """Name of the sensor as in the topic, without the prefix: ``p01/zephyr_left``."""
        parts = self.base.split("/")
        before = parts[: len(parts) - len(prefix.split("/") if prefix else []) - 1]
        return "/".join([*before, parts[-1]])


def sanitise(text: str) -> str:
    """Turn any string into one token of a ROS name, different strings into different ones.

    Letters, digits and single inner underscores stay. Every other byte of the
    UTF-8 form becomes ``_xHH``, and so does an underscore that is doubled, at an
    end, or would read as the start of an escape. A token that would not start
    with a letter is put behind ``x0``, as is one that starts with it; the empty
    string is ``x0``.

    A token of more than 64 characters is cut and ends in ``_x68`` and 16 hex
    digits of its SHA-256: beyond that length only the hash tells strings apart.

    Returns
    -------
    str
        ``[A-Za-z][A-Za-z0-9_]*``, at most 64 characters, no ``__``, no ``_`` at its end.
    """
    return _cut(_marked(_escape(text)))


def sensor_topic_name(identity: DeviceIdentity, *, by_unit: bool = False) -> str:
    """Return the topic part of a device: ``<sensor>[_<label>][_<unit>]``.

    Different (sensor, label) pairs give different names if no sensor's name is
    another's followed by an underscore and more; see the module's text.
    """
    return _names(identity)[1 if by_unit else 0]


def topic(
    identity: DeviceIdentity, data_name: str, prefix: str = "biosensors", *, by_unit: bool = False
) -> str:
    """Return the relative topic name ``[<participant>/]<prefix>/<sensor>[_<label>]/<data>``.

    Parameters
    ----------
    prefix
        Valid ROS name, taken as it is; left out if empty.
    by_unit
        Append the unit to the sensor: ``zephyr_BHT012345``.
    """
    sensor = sensor_topic_name(identity, by_unit=by_unit)
    return TopicName(_base(identity, sensor, prefix), _data_token(data_name)).name


def resolve_topics(
    streams: Mapping[Key, tuple[DeviceIdentity, str]],
    prefix: str = "biosensors",
    *,
    gone: Iterable[DeviceIdentity] = (),
) -> dict[Key, TopicName]:
    """Give every stream its topic, such that no two devices ever share one.

    Devices that would share a name all get the next longer one: first with the
    unit, and if even that is another's, one with every field kept apart. The
    result depends on the set of devices alone, never on their order.

    Parameters
    ----------
    streams
        Identity and data name by any key, usually the outlet's uid.
    prefix
        As in :func:`topic`.
    gone
        Devices that were here before; their names are not given to others.
    """
    ranks = _ranks({identity for identity, _ in streams.values()}.union(gone))
    claims = Counter(streams.values())
    return {
        key: TopicName(
            base=_base(identity, _names(identity)[ranks[identity]], prefix),
            data=_data_token(data_name),
            conflict=ranks[identity] > 0,
            duplicate=claims[identity, data_name] > 1,
        )
        for key, (identity, data_name) in streams.items()
    }


def lsl_name(identity: DeviceIdentity, data_name: str) -> str:
    """Return an outlet's name, ``[<participant>-]<sensor>[__<label>]-<unit>-<data>``.

    Fields hold neither ``-`` nor ``__``, so the name tells all five apart. It
    consists of ASCII letters, digits, ``_`` and ``-``.
    """
    participant = f"{_escape(identity.participant)}-" if identity.participant else ""
    label = f"__{_escape(identity.label)}" if identity.label else ""
    sensor, unit, data = map(_escape, (identity.sensor, identity.unit, data_name))
    return f"{participant}{sensor}{label}-{unit}-{data}"


def source_id(identity: DeviceIdentity, data_name: str) -> str:
    """Return an outlet's source id, by which LSL recovers a stream.

    With a participant or a label the place on the body is what counts, so that
    a replaced strap continues its stream: ``[<participant>@]<sensor>[.<label>]-<data>``.
    Else it is the device: ``<sensor>-<unit>-<data>``. It holds neither quotes
    nor blanks, which would break LSL queries.
    """
    sensor, data = _escape(identity.sensor), _escape(data_name)
    if not (identity.participant or identity.label):
        return f"{sensor}-{_escape(identity.unit)}-{data}"
    participant = f"{_escape(identity.participant)}@" if identity.participant else ""
    label = f".{_escape(identity.label)}" if identity.label else ""
    return f"{participant}{sensor}{label}-{data}"


def foreign_identity(
    name: str, content_type: str, source_id: str, hostname: str
) -> tuple[DeviceIdentity, str]:
    """Return identity and data name of a stream that another program offers.

    Those of a :mod:`known program <.known_senders>` have good ones. Else the stream's name
    stands for the sensor, its type (``data`` if empty) for the data, its source id (the host if
    empty) for the unit. All keep their case and characters; :func:`topic` makes ROS names of
    them.
    """
    known = known_stream(name, content_type, source_id, hostname)
    if known is not None:
        return known[1], known[0].data_name
    return DeviceIdentity(sensor=name, unit=source_id or hostname), content_type or "data"


def _escape(text: str) -> str:
    # A lone surrogate has no UTF-8 form, but a hostile stream may send one.
    one_char_a_byte = text.encode("utf-8", "surrogatepass").decode("latin-1")
    return _FORBIDDEN.sub(lambda match: f"_x{ord(match[0]):02X}", one_char_a_byte)


def _marked(escaped: str) -> str:
    starts_well = escaped[:1].isalpha() and not escaped.startswith(_MARKER)
    return escaped if starts_well else _MARKER + escaped


def _cut(token: str) -> str:
    if len(token) <= _TOKEN_LENGTH:
        return token
    kept = token[: _TOKEN_LENGTH - len(_HASH_MARK) - _HASH_LENGTH].rstrip("_")
    return f"{kept}{_HASH_MARK}{sha256(token.encode()).hexdigest()[:_HASH_LENGTH]}"


def _data_token(data_name: str) -> str:
    """Sanitise a data name; ``_chunk`` and ``_stamped`` belong to the topics made from it."""
    return _cut(_TAKEN_SUFFIX.sub(r"_x5F\1", _marked(_escape(data_name))))


def _base(identity: DeviceIdentity, sensor: str, prefix: str) -> str:
    participant = sanitise(identity.participant) if identity.participant else ""
    return "/".join(part for part in (participant, prefix, sensor) if part)


def _names(identity: DeviceIdentity) -> tuple[str, str, str]:
    """Names of a device from plain to unmistakable; the last is unlike any of the others."""
    plain = f"{identity.sensor}_{identity.label}" if identity.label else identity.sensor
    fields = (identity.sensor, identity.label, identity.unit)
    return (
        sanitise(plain),
        sanitise(f"{plain}_{identity.unit}"),
        _cut(_marked(_FIELD_MARK.join(_escape(field) for field in fields))),
    )


def _ranks(devices: Iterable[DeviceIdentity]) -> dict[DeviceIdentity, int]:
    """Choose which of its names each device gets: 0 plain, 1 with the unit, 2 unmistakable.

    A name that was too short for one device is closed to all, so that a listener
    never hears another device on a topic that it knows.
    """
    names = {device: _names(device) for device in devices}
    ranks = dict.fromkeys(names, 0)
    while True:
        claims = Counter(
            (device.participant, name)
            for device, rank in ranks.items()
            for name in set(names[device][: rank + 1])
        )
        crowded = [
            device
            for device, rank in ranks.items()
            if rank < 2 and claims[device.participant, names[device][rank]] > 1
        ]
        if not crowded:
            return ranks
        for device in crowded:
            ranks[device] += 1
