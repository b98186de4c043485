"""The ports of LSL, some of them really held."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable, Generator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from biosensor_common.doctor.check import Level
from biosensor_common.doctor.probe import Probe
from biosensor_gateway.doctor.context import Context
from tests.doctor.conftest import POLAR, ZEPHYR, above_ok, only
from tests.doctor.outlets import Offered

if TYPE_CHECKING:
    from tests.doctor.conftest import Examine

pytestmark = pytest.mark.nightly

TCP, UDP = socket.SOCK_STREAM, socket.SOCK_DGRAM
COUNT = 40

Hold = Callable[[socket.SocketKind, int], None]


@pytest.fixture
def hold() -> Generator[Hold]:
    with ExitStack() as stack:

        def bind(kind: socket.SocketKind, port: int) -> None:
            holder = stack.enter_context(socket.socket(socket.AF_INET, kind))
            holder.bind(("", port))
            if kind is TCP:
                holder.listen()

        yield bind


@pytest.fixture
def ports(lsl_file: Callable[[str], Path]) -> range:
    """Ports that nobody has, as those of LSL; discovery is on the one before them."""
    for first in range(30001, 60000, 101):
        attempt = range(first, first + COUNT)
        if all(_is_free(port) for port in range(first - 1, first + COUNT)):
            # The settings' own range has priority.
            lsl_file(
                f"[ports]\nBasePort = {first}\nMulticastPort = {first - 1}\n"
                "[multicast]\nResolveScope = machine\n"
            )
            return attempt
    raise AssertionError("no ports")


def _is_free(port: int) -> bool:
    try:
        for kind in (TCP, UDP):
            with socket.socket(socket.AF_INET, kind) as attempt:
                attempt.bind(("", port))
    except OSError:
        return False
    return True


def settings(devices: str = "", count: int = COUNT) -> str:
    return f"[lsl]\nport_range = {count}\n{devices}"


def test_free_ports(examine: Examine, configured: Callable[[str], Context], ports: range) -> None:
    found = examine(configured(settings(POLAR)), "ports")
    assert not above_ok(found)
    said = f"{ports[0]} to {ports[-1]}: {COUNT} of {COUNT} ports are free"
    assert [each.what for each in found[1:]] == [f"TCP {said}", f"UDP {said}"]


def test_held_ports_and_by_whom(
    examine: Examine, configured: Callable[[str], Context], ports: range, hold: Hold
) -> None:
    for port in ports[:3]:
        hold(TCP, port)
    hold(UDP, ports[5])
    found = examine(configured(settings(POLAR)), "ports")
    assert not above_ok(found)
    me = f"(process {os.getpid()})"
    assert f": {COUNT - 3} of {COUNT} ports are free" in only(found, f"{me}: 3").what
    assert f": {COUNT - 1} of {COUNT} ports are free" in only(found, f"UDP {ports[0]} to").what


def test_too_few_free_ports_are_an_error(
    examine: Examine, configured: Callable[[str], Context], ports: range, hold: Hold
) -> None:
    for port in ports[: COUNT - 8]:
        hold(UDP, port)
    (found,) = above_ok(examine(configured(settings(POLAR)), "ports"))
    assert found.level is Level.ERROR
    assert "UDP" in found.what
    # Seven streams and the agent's own, two ports each.
    assert "the streams of the settings need 16" in found.what
    assert (str(ports[0]) in found.fix) == (sys.platform == "linux")


def test_a_range_that_is_too_small_is_a_warning(
    examine: Examine, configured: Callable[[str], Context], ports: range
) -> None:
    del ports
    found = above_ok(examine(configured(settings(POLAR + ZEPHYR.format("/dev/x"), 8)), "ports"))
    assert [each.level for each in found] == [Level.WARNING] * 2
    assert all("port_range = 256" in each.fix for each in found)


def test_discovery_that_another_program_has_alone(
    examine: Examine, context: Context, ports: range, hold: Hold
) -> None:
    hold(UDP, ports[0] - 1)
    (found,) = above_ok(examine(context, "ports"))
    assert found.level is Level.ERROR
    assert found.what.startswith(f"UDP {ports[0] - 1} is held by ")
    assert f"(process {os.getpid()})" in found.what


def test_what_the_other_checks_hold_is_free(
    examine: Examine, configured: Callable[[str], Context], ports: range
) -> None:
    context = configured(settings())
    with Probe("offer", 30.0, config=context.config, source_id="doctor") as probe:
        assert probe.answer() == {"open": True}
        found = examine(context, "ports")
    assert f"TCP {ports[0]} to {ports[-1]}: {COUNT} of {COUNT} ports are free" == found[1].what


def test_discovery_is_shared_by_lsl_programs(
    examine: Examine, context: Context, session: str, offer: Callable[..., None]
) -> None:
    offer(Offered(session, session))
    found = examine(context, "ports")
    assert only(found, "UDP 16571 (discovery) can be had")
    assert "python" in only(found, "TCP 16572").what
