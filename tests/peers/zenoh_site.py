"""One part of a site, on Zenoh's own engine; runs in `.venv-peers`.

    python zenoh_site.py router CONFIGURATION
    python zenoh_site.py say PERIOD_S KEY [KEY ...]
    python zenoh_site.py hear KEY [KEY ...]

A router runs with a configuration in JSON5. The others are clients of the router on this
computer: one says a number, ever higher, under each key; one hears each key. Each says
``ready`` and goes on until its standard input ends; then the speaker prints how many numbers it
has said, the listener what it heard, by key, as JSON.
"""

from __future__ import annotations

import importlib
import json
import sys
import threading
from collections import defaultdict
from pathlib import Path
from typing import Any

# By name, since it is in the peers' environment only, where nothing is type-checked.
_zenoh: Any = importlib.import_module("zenoh")

CLIENT = """{mode: "client", connect: {endpoints: ["tcp/127.0.0.1:7447"]},
             scouting: {multicast: {enabled: false}}}"""


def until_told() -> threading.Event:
    """Return what is set when standard input ends."""
    told = threading.Event()

    def read() -> None:
        sys.stdin.read()
        told.set()

    threading.Thread(target=read, daemon=True).start()
    print("ready", flush=True)
    return told


def say(session: Any, period_s: float, keys: list[str]) -> int:
    publishers = [session.declare_publisher(key) for key in keys]
    told, number = until_told(), 0
    while not told.wait(period_s):
        for publisher in publishers:
            publisher.put(str(number))
        number += 1
    return number


def hear(session: Any, keys: list[str]) -> dict[str, list[int]]:
    heard: dict[str, list[int]] = defaultdict(list)

    def take(sample: Any) -> None:
        heard[str(sample.key_expr)].append(int(sample.payload.to_string()))

    # As a ROS subscription does; one to all of them at once would not pass the rules.
    for key in keys:
        session.declare_subscriber(key, take)
    until_told().wait()
    return heard


def main() -> None:
    role, *words = sys.argv[1:]
    text = Path(words[0]).read_text() if role == "router" else CLIENT
    with _zenoh.open(_zenoh.Config.from_json5(text)) as session:
        if role == "router":
            until_told().wait()
            return
        said = hear(session, words) if role == "hear" else say(session, float(words[0]), words[1:])
        print(json.dumps(said), flush=True)


if __name__ == "__main__":
    main()
