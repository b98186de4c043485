"""Senders that claim to be one stream have the topics that a node gives them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from biosensor_common.lsl.network import numbered
from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity
from biosensor_common.stream_header import foreign_header
from biosensor_gateway.page.network.stream_list import StreamList
from biosensor_gateway.page.network.view import Viewer
from biosensor_gateway.streaming.counters import Counters, counters_text
from tests.ros.test_namesakes import Info

NOW_S = 1000.0
FIRST, SECOND = Info("1", "lab-pc", 1.0), Info("2", "stim-pc", 2.0)
OTHER_FORMAT = Info("3", "stim-pc", 2.5, 1)


class Page:
    """A page that looks at senders."""

    def __init__(self) -> None:
        self.listing = StreamList()
        self._now_s = NOW_S

    def look(self, *present: Any, after_s: float = 10.0) -> dict[str, str]:
        """Look for some time; return the topics of the senders."""
        for _ in range(int(after_s)):
            self._now_s += 1.0
            self.listing.update(present, self._now_s)
        for each in self.listing.streams.values():
            each.header = numbered(foreign_header(each.core), each.namesake)
        view = Viewer().view(self.listing, 0, (), self._now_s)
        topics = {each.source_id: each.topic for of in view.devices for each in of.streams}
        return {each.uid: topics[str(n)] for n, each in self.listing.streams.items()}


def test_each_has_its_number_whichever_was_found_first() -> None:
    one, two, three = (f"/biosensors/MyMarkerStream/Markers{end}" for end in ("", "_2", "_3"))
    assert Page().look(OTHER_FORMAT, SECOND, FIRST) == {"1": one, "2": two, "3": three}
    assert Page().look(SECOND) == {"2": one}


def test_one_that_starts_again_keeps_it() -> None:
    page = Page()
    page.look(FIRST, SECOND)
    page.look(FIRST)
    again = Info("4", "stim-pc", 9.0)
    assert page.look(FIRST, again) == {
        "1": "/biosensors/MyMarkerStream/Markers",
        "4": "/biosensors/MyMarkerStream/Markers_2",
    }


def test_what_the_agent_says_of_its_stream_stands_with_it() -> None:
    strap = DeviceIdentity("polar_h10", "A1", "P01")
    heart, counts = Info("1", "lab-pc", 1.0, 4), Info("2", "lab-pc", 1.0)
    vars(heart)["_told"] |= {"name": "hr", "type": "HR", "source_id": source_id(strap, "hr")}
    vars(counts)["_told"] |= {"type": "Counters", "source_id": "gateway-pc-counters"}
    senders: Any = [heart, counts]
    listing = StreamList()
    listing.update(senders, NOW_S)
    of_hr, of_counts = listing.streams.values()
    for stream, identity in ((of_hr, strap), (of_counts, DeviceIdentity("gateway", "pc"))):
        header = foreign_header(stream.core)
        stream.header = replace(header, identity=identity, foreign=False)
    refused = {of_hr.core.source_id: ["2 samples were not sent: hr was 500"]}
    told = counters_text({each: Counters(lost=3) for each in refused}, refused=refused)
    of_counts.received.raw = told.encode()
    view = Viewer().view(listing, 0, (), NOW_S)
    (shown,) = (each for of in view.devices for each in of.streams if each.lsl_name == "hr")
    assert (shown.note, shown.lost) == ("2 samples were not sent: hr was 500", 3)
