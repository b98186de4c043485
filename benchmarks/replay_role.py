"""Plays a recording, watched: ``python -m benchmarks.replay_role FILE SPEED``; prints JSON."""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path

from benchmarks.child import Orders, say
from biosensor_gateway.recording.contents.choice import Selection, choose
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.replay.player import Player, PlayOptions


def main() -> None:
    path, speed = Path(sys.argv[1]), float(sys.argv[2])
    orders = Orders()
    with open_contents(path) as contents:
        player = Player(choose(contents, Selection()), PlayOptions(speed=speed), "bench")
        player.offer()
        say("offered")
        while orders.poll() is None and not orders.closed.is_set():
            time.sleep(0.05)
        begun_s, used_s = time.monotonic(), time.process_time()
        player.run(threading.Event())
        wall_s, cpu_s = time.monotonic() - begun_s, time.process_time() - used_s
    late_ms = {f"p{each}": 1e3 * player.lateness.percentile_s(each) for each in (50, 99)}
    say(json.dumps({"wall_s": wall_s, "cpu_s": cpu_s, "sent": player.progress().sent, **late_ms}))


if __name__ == "__main__":
    main()
