"""Makes captures of the recordings of a real BioHarness that another program made.

They hold what came from the device, and when; what it was asked for is told by its
acknowledgements, each of which is to follow its request here, too.
"""

from __future__ import annotations

from itertools import accumulate
from pathlib import Path

from biosensor_gateway.captures.file import ENDING, Capture, Event, Header, packed
from biosensor_gateway.devices.zephyr.driver.protocol import Request, enable
from biosensor_gateway.devices.zephyr.simulator import recorded_bioharness
from biosensor_gateway.devices.zephyr.simulator.recorded_bioharness import (
    RECORDING_150_S,
    read_timing,
    split,
)
from biosensor_gateway.transports.tap import What

SOURCE = (
    "zephyr-bt, recorded in 2012 by its authors, BSD-2-Clause; requests made up from their "
    "acknowledgements"
)
FOLDER = Path(recorded_bioharness.__file__).parent / "recordings"
FILES = Path(__file__).parents[1] / "captures" / "files"
FILE = FILES / "zephyr" / f"BioHarness_3{ENDING}"


def capture(name: str = RECORDING_150_S) -> Capture:
    """Return the capture of a recording with the times of its reads."""
    data = (FOLDER / f"{name}.dat").read_bytes()
    reads = read_timing((FOLDER / f"{name}-timing.csv").read_text("ascii"))
    items = list(split(data))
    ends = list(accumulate(len(item.data) for item in items))
    answers = {end: item for end, item in zip(ends, items, strict=True) if item.is_answer}
    events = [Event(t=0.0, link=0, what=What.OPENED)]
    position = 0
    for read in reads:
        t = round(read.time - reads[0].time, 6)
        cuts = sorted(each for each in answers if position < each <= read.total_bytes)
        for end in dict.fromkeys((*cuts, read.total_bytes)):
            if end in answers:
                begin = end - len(answers[end].data)
                events += _came(t, data[position:begin])
                request = enable(Request(answers[end].data[1]), on=True)
                events.append(Event(t=t, link=0, what=What.SENT, data=request.hex()))
                position = max(position, begin)
            events += _came(t, data[position:end])
            position = end
    header = Header(
        sensor="zephyr",
        manufacturer="Zephyr",
        model="BioHarness 3",
        recorded="2012-09",
        seconds=round(events[-1].t, 1),
        licence="BSD-2-Clause",
        source=SOURCE,
        system="not known",
    )
    return Capture(header=header, events=tuple(events))


def _came(t: float, data: bytes) -> list[Event]:
    return [Event(t=t, link=0, what=What.CAME, data=data.hex())] if data else []


if __name__ == "__main__":
    FILE.write_bytes(packed(capture()))
