"""Makes a capture of what a real EmotiBit wrote to its card: ``... FILE.csv``.

The lines are those that it sends over the network. When each would have arrived nobody knows, so
the times are the device's own, and the conversation before is made up.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from biosensor_gateway.captures.file import ENDING, Arrivals, Capture, Event, Header, packed
from biosensor_gateway.transports.tap import What

FILES = Path(__file__).parents[1] / "captures" / "files"
FILE = FILES / "emotibit" / f"EmotiBit{ENDING}"
SOURCE = (
    "the sample recording of ofxEmotiBit, written by the device to its card in 2025, MIT; when it "
    "would have arrived is not known, and its connection is made up"
)
_CONVERSATION = (
    (What.SENT, "asking", b"0,0,0,HE,1,100\n"),
    (What.CAME, "asking", b"1,0,4,HH,1,100,DP,-1,DI,MD-V5-0000000\n"),
    (What.SENT, "asking", b"0,1,4,EC,1,100,CP,34285,DP,42523\n"),
    (What.CAME, "control", b""),
    (What.SENT, "control", b"0,0,0,MN,1,100\n"),
    (What.CAME, "asking", b"2,1,2,PO,1,100,DP,42523\n"),
)
_BEGIN_S = 0.1


def capture(lines: Iterable[bytes]) -> Capture:
    """Return the capture of a file's lines."""
    events = [Event(t=0.0, link=0, what=What.OPENED)]
    events += [Event(t=0.0, link=0, what=w, at=at, data=d.hex()) for w, at, d in _CONVERSATION]
    events += [
        Event(t=t, link=0, what=What.CAME, at="data", data=data.hex())
        for t, data in _packets(lines)
    ]
    header = Header(
        sensor="emotibit",
        manufacturer="EmotiBit",
        model="EmotiBit",
        left_out=("host", "port"),
        recorded="2025-06",
        seconds=round(events[-1].t, 1),
        licence="MIT",
        source=SOURCE,
        system="not known",
        arrivals=Arrivals.UNKNOWN,
    )
    return Capture(header=header, events=tuple(events))


def _packets(lines: Iterable[bytes]) -> Iterator[tuple[float, bytes]]:
    """Yield packets of lines, each at the device's time of the newest line until then."""
    begin_ms, newest_ms, packet = None, 0, b""
    for line in lines:
        stamp_ms = int(line.partition(b",")[0])
        begin_ms = stamp_ms if begin_ms is None else begin_ms
        if stamp_ms > newest_ms and packet:
            yield round(_BEGIN_S + (newest_ms - begin_ms) / 1000, 3), packet
            packet = b""
        newest_ms = max(newest_ms, stamp_ms)
        packet += line.strip() + b"\n"
    if begin_ms is not None:
        yield round(_BEGIN_S + (newest_ms - begin_ms) / 1000, 3), packet


if __name__ == "__main__":
    FILE.parent.mkdir(parents=True, exist_ok=True)
    FILE.write_bytes(packed(capture(Path(sys.argv[1]).read_bytes().splitlines())))
