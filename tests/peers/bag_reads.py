"""Reads a bag by the libraries mcap and mcap-ros2-support, and prints what is in it as JSON.

bag_reads.py FILE.mcap
"""

from __future__ import annotations

import importlib
import json
import math
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

# By name, since they are in the peers' environment only, where nothing is type-checked.
mcap_reader: Any = importlib.import_module("mcap.reader")
mcap_ros2: Any = importlib.import_module("mcap_ros2.decoder")


def value(read: Any) -> Any:
    """Return a field as JSON has it; NaN as text."""
    if isinstance(read, bool | int | str):
        return read
    if isinstance(read, float):
        return read if math.isfinite(read) else str(read)
    if isinstance(read, bytes | list | tuple) or hasattr(read, "tolist"):
        return [value(each) for each in cast("Iterable[Any]", read)]
    names = [name for name in read.__slots__ if not name.startswith("_")]
    return {name: value(getattr(read, name)) for name in names}


def main() -> None:
    topics: dict[str, dict[str, Any]] = {}
    with Path(sys.argv[1]).open("rb") as file:
        decoders = [mcap_ros2.DecoderFactory()]
        reader = mcap_reader.make_reader(file, decoder_factories=decoders, validate_crcs=True)
        summary = reader.get_summary()
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            qos = channel.metadata["offered_qos_profiles"]
            empty: dict[str, Any] = {"type": schema.name, "qos": qos, "messages": []}
            known = topics.setdefault(channel.topic, empty)
            known["messages"].append([message.log_time, value(decoded)])
    count = summary.statistics.message_count
    print(json.dumps({"count": count, "topics": topics}))


if __name__ == "__main__":
    main()
