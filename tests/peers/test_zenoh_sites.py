"""The rules of ``docs/sites.md`` between two sites, in routers of Zenoh's own engine.

Two networks are joined by a link of 40 ms, each with a router. What is said at one site has the
names that rmw_zenoh gives our topics. Features, states and events cross, also over a cut; raw
signals do not, and everybody at the same site hears everything.
"""

from __future__ import annotations

import json
import re
import subprocess
import time
from collections.abc import Generator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.demo.virtual_devices import one_of_each
from biosensor_gateway.devices.registry import declaration
from tests.rigs.hosts.lan import PORT, Host, Lan
from tests.rigs.hosts.link import Delays, Link

pytestmark = [pytest.mark.system, pytest.mark.timeout(180)]

ROOT = Path(__file__).parents[2]
PYTHON = ROOT / ".venv-peers" / "bin" / "python"
PROGRAM = Path(__file__).with_name("zenoh_site.py")
PAGE = ROOT / "docs" / "sites.md"
# As often as such topics come. Ten times a second each, the routers' buffers overflow in the cut.
PERIOD_S = 0.5
# Less than a link's lease of 10 s; TCP tries again after 6.3 s or 12.7 s.
CUT_S, HEALED_S = 5.0, 8.0
DEADLINE_S = 60.0
# Irregular at one sensor and raw at another; and a raw one that only some headsets have.
_RAW_ELSEWHERE = {"st", "temp"}
_KEPT_HERE = {("emotiv_insight", "gyro")}
_LISTS = ("diagnostics", "lsl_to_ros/streams")


def key(topic: str) -> str:
    """What rmw_zenoh calls a topic: domain, name, type and hash of the type."""
    return f"0/{topic}/std_msgs::msg::dds_::Float32_/RIHS01_{topic.encode().hex()[:8]}"


def keys() -> tuple[set[str], set[str]]:
    """Those of every topic, with and without stamps: what shall cross, and what shall not."""
    crossing, staying = {key(name) for name in _LISTS}, set[str]()
    for sensor in (*one_of_each(), "gateway"):
        identity = DeviceIdentity(sensor, "pc", "" if sensor == "gateway" else "p01")
        for stream in declaration(sensor).streams:
            # The belt's two streams have a rate by a setting; one of them is a signal.
            is_low = not stream.rate or stream.data_name in {"bpm", "counters"}
            is_low = is_low and stream.data_name not in _RAW_ELSEWHERE
            is_low = is_low and (sensor, stream.data_name) not in _KEPT_HERE
            topic = naming.topic(identity, stream.data_name)
            (crossing if is_low else staying).update({key(topic), key(f"{topic}_stamped")})
    return crossing, staying


def configuration(router: str, *, is_first: bool) -> str:
    """Return what the page gives, for these computers."""
    blocks = re.findall(r"```json5\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    lines = blocks[0].replace("10.66.0.1", router).replace("wg0", PORT).splitlines()
    return "\n".join(line for line in lines if not (is_first and line.startswith("  connect:")))


@contextmanager
def part(host: Host, *words: str) -> Generator[subprocess.Popen[str]]:
    """Run a part of a site until the block ends; it does when its input is closed."""
    # A skip would pass where nothing was tried.
    if not (PYTHON.parents[1] / ".installed").exists():
        pytest.fail("the peers are not installed: run `make venv-peers` first")
    with subprocess.Popen(
        host.command(str(PYTHON), str(PROGRAM), *words),
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n", words
            yield process
        finally:
            process.kill()


def told(process: subprocess.Popen[str]) -> str:
    """Close its input, and return what it says then."""
    said, _ = process.communicate(timeout=DEADLINE_S)
    return said


class Heard(NamedTuple):
    """How many numbers were said under each key, and which were heard at each site, by key."""

    said: int
    near: dict[str, list[int]]
    far: dict[str, list[int]]


@pytest.fixture(scope="module")
def heard(tmp_path_factory: pytest.TempPathFactory) -> Heard:
    folder = tmp_path_factory.mktemp("zenoh")
    with ExitStack() as stack:
        first = stack.enter_context(Lan({"north": 0}))
        second = stack.enter_context(Lan({"south": 0}, "10.78.0"))
        link = stack.enter_context(Link(first, second, Delays(0.020, 0.020), folder))
        north, south = first["north"], second["south"]
        for host in (north, south):
            file = folder / f"{host.name}.json5"
            file.write_text(configuration(first.address("north"), is_first=host is north))
            stack.enter_context(part(host, "router", str(file)))
        every = sorted(set[str]().union(*keys()))
        listeners = [stack.enter_context(part(host, "hear", *every)) for host in (north, south)]
        # Until the two routers have found each other and know who listens.
        time.sleep(6.0)
        speaker = stack.enter_context(part(north, "say", str(PERIOD_S), *every))
        time.sleep(2.0)
        link.cut()
        time.sleep(CUT_S)
        link.heal()
        time.sleep(HEALED_S)
        said = int(told(speaker))
        time.sleep(4.0)
        near, far = (json.loads(told(each)) for each in listeners)
    return Heard(said, near, far)


def test_features_states_and_events_cross_and_nothing_is_lost(heard: Heard) -> None:
    crossing, _ = keys()
    whole = list(range(heard.said))
    assert {name for name in crossing if heard.far.get(name) != whole} == set()


def test_raw_signals_stay_where_they_are(heard: Heard) -> None:
    crossing, staying = keys()
    assert heard.far.keys() == crossing
    assert len(staying) > 20


def test_everybody_at_the_same_site_hears_everything(heard: Heard) -> None:
    crossing, staying = keys()
    whole = list(range(heard.said))
    assert heard.near == dict.fromkeys(crossing | staying, whole)
