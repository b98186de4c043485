"""Messages of our types that are not what they are elsewhere: said in a sentence, and left out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.recording.bag.errors import BagError, BagReason
from biosensor_gateway.recording.bag.importing import Imported, import_bag
from biosensor_gateway.recording.bag.recorded_streams import TOPIC, RecordedStream, stream_text
from biosensor_gateway.recording.bag.types import EVENT, SAMPLES
from tests.bags import made, mcap_bytes

HEADER, TIME = "std_msgs/msg/Header", "builtin_interfaces/msg/Time"
GOOD = mcap_bytes.topic(
    9, "/load", "std_msgs/msg/Float64", made.typestore().types["std_msgs/msg/Float64"](1.5)
)
STORE = made.typestore()
TYPES = STORE.types
FIELDS = [
    (kind, owner, field)
    for kind, owners in ((SAMPLES, (SAMPLES, HEADER, TIME)), (EVENT, (EVENT,)))
    for owner in owners
    for field, _ in STORE.fielddefs[owner][1]
]


def _stamp() -> Any:
    return TYPES[HEADER](TYPES[TIME](1_790_000_000, 0), "zephyr")


def _samples(labels: list[str], units: list[str], values: int = 2) -> Any:
    empty = np.empty(0, np.int64)
    offsets = np.arange(2)
    return TYPES[SAMPLES](
        _stamp(), 0, 0, False, labels, units, offsets, np.arange(float(values)), empty
    )


def _event(text: str = "begin") -> Any:
    return TYPES[EVENT](_stamp(), 0, text)


def _import(folder: Path, *records: bytes) -> Imported:
    (folder / "a.mcap").write_bytes(mcap_bytes.file(*records, GOOD))
    return import_bag(folder / "a.mcap", folder / "a.xdf")


@pytest.mark.parametrize(("kind", "owner", "field"), FIELDS)
def test_a_definition_without_a_field_of_ours_is_said(
    tmp_path: Path, kind: str, owner: str, field: str
) -> None:
    content = STORE.serialize_cdr(_samples(["ecg"], ["mV"]) if kind == SAMPLES else _event(), kind)
    definition, _ = STORE.generate_msgdef(kind, ros_version=2)
    main, *others = definition.split("=" * 80 + "\n")
    parts = {kind: main} | {_type_of(part): part for part in others}
    parts[owner] = parts[owner].replace(f" {field}\n", " other\n")
    text = ("=" * 80 + "\n").join(parts.values())
    imported = _import(
        tmp_path,
        mcap_bytes.schema(1, kind, text),
        mcap_bytes.channel(1, 1, "/biosensors/zephyr/ecg_stamped", {}),
        mcap_bytes.message(1, mcap_bytes.BEGIN_NS, bytes(content)),
    )
    (why,) = imported.left_out.values()
    if owner == TIME:
        assert why == f"the definition of {kind} cannot be read"
    else:
        assert why == f"its bag defines {owner} without the field {field}, or as another type"
    assert imported.streams == (("/load", 1),)


def _type_of(part: str) -> str:
    package, _, name = part.partition("\n")[0].removeprefix("MSG: ").partition("/")
    return f"{package}/msg/{name}"


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (_samples([], [], 0), "0 labels and 0 units are no channels of a stream"),
        (_samples(["ecg"], ["mV", "s"]), "1 labels and 2 units are no channels of a stream"),
        (_samples(["a", "b"], ["", ""]), "it has another number of values than its stream"),
    ],
)
def test_samples_that_are_of_no_stream_are_left_out(tmp_path: Path, message: Any, why: str) -> None:
    topic = "/biosensors/zephyr/ecg_stamped"
    imported = _import(tmp_path, mcap_bytes.topic(1, topic, SAMPLES, message))
    assert imported.damages == (f"{topic}: 1 messages are left out ({why})",)


@pytest.mark.parametrize("form", ["float32", "string"])
def test_text_for_numbers_is_left_out(tmp_path: Path, form: str) -> None:
    header = made.xdf_file.stream_header(1, "x", fmt=form)
    xml = header[header.index(b"<info") :].decode()
    told = stream_text(RecordedStream(1, "/x_stamped", (), xml, ()))
    kind, message = (EVENT, _event()) if form != "string" else (SAMPLES, _samples(["a"], [""]))
    imported = _import(
        tmp_path,
        mcap_bytes.topic(1, TOPIC, "std_msgs/msg/String", TYPES["std_msgs/msg/String"](told)),
        mcap_bytes.topic(2, "/x_stamped", kind, message),
    )
    (damage,) = imported.damages
    assert "it has text for numbers, or numbers for text" in damage


def test_a_bag_of_nothing_else_is_refused(tmp_path: Path) -> None:
    records = mcap_bytes.topic(1, "/x_stamped", SAMPLES, _samples([], [], 0))
    (tmp_path / "a.mcap").write_bytes(mcap_bytes.file(records))
    with pytest.raises(BagError) as caught:
        import_bag(tmp_path / "a.mcap", tmp_path / "a.xdf")
    assert caught.value.reason is BagReason.EMPTY
