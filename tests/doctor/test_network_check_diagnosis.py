"""What is said of two computers, for systems and networks that are not here."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from biosensor_common.doctor.check import AGENT, NODE, Finding, Level
from biosensor_common.doctor.network_check.command import CHECK
from biosensor_common.doctor.network_check.command import Outcome as Checked
from biosensor_common.doctor.network_check.diagnosis import judge
from biosensor_common.doctor.network_check.facts import (
    Arrivals,
    Computer,
    End,
    Look,
    Stream,
    as_message,
    read,
)
from biosensor_common.doctor.report import Report
from biosensor_common.lsl.api_file import Ports
from tests.doctor.conftest import only

if TYPE_CHECKING:
    from tests.doctor.conftest import Outcome

PORTS = Ports(16571, 16572, 16827)
ALL = {16572: True, 16827: True}
NONE = {16572: False, 16827: False}
PART = {16572: True, 16827: False}
SEEN = Look(True, True, "", True, 0.001, 0.002)
UNSEEN = Look(False, False)


def computer(name: str, **changed: object) -> Computer:
    own, other = ("10.0.0.1", "10.0.0.2") if name == "lab-pc" else ("10.0.0.2", "10.0.0.1")
    plain = Computer(
        name=name,
        system="linux",
        program=AGENT if name == "lab-pc" else NODE,
        address=own,
        other=other,
        is_near=True,
        session="default",
        ports=PORTS,
    )
    return replace(plain, **changed)  # type: ignore[arg-type]


def arrivals(**changed: object) -> Arrivals:
    return replace(Arrivals(("10.0.0.9",), True, ALL, ALL), **changed)  # type: ignore[arg-type]


@pytest.fixture
def pc() -> End:
    return End(computer("lab-pc"), arrivals(), SEEN)


@pytest.fixture
def robot() -> End:
    return End(computer("robot"), arrivals(), SEEN)


def bad(findings: list[Finding]) -> list[Finding]:
    return [each for each in findings if each.level in {Level.ERROR, Level.WARNING}]


def test_what_one_side_found_reaches_the_other_whole(pc: End, robot: End) -> None:
    for end in (pc, robot):
        assert read(End, json.loads(json.dumps(as_message(end)))) == end


def test_windows_gets_its_own_command_and_the_answer_goes_to_the_right_side(
    pc: End, robot: End
) -> None:
    closed = replace(pc, computer=replace(pc.computer, system="win32"), arrivals=arrivals(tcp=NONE))
    deaf = replace(robot, look=replace(SEEN, received=False))
    (finding,) = bad(judge(closed, deaf))
    command = "dir=in action=allow protocol=TCP localport=16572-16827 remoteip=LocalSubnet"
    assert finding.fix.startswith("here, as administrator: netsh advfirewall firewall add rule")
    assert command in finding.fix
    # From the robot's side it is the other computer that has to be opened.
    (mirrored,) = bad(judge(deaf, closed))
    assert mirrored.what == "lab-pc does not let in TCP 16572 to 16827 from this computer"
    assert mirrored.fix.startswith("on lab-pc, as administrator: netsh")
    # Through a VPN, who is to be let in is no neighbour.
    far = replace(closed, computer=replace(closed.computer, is_near=False))
    assert "remoteip=10.0.0.2 " in bad(judge(far, deaf))[0].fix


def test_only_the_firewall_that_is_on_is_named(pc: End, robot: End) -> None:
    shut = replace(
        robot,
        computer=replace(robot.computer, firewalls=("ufw", "nftables")),
        arrivals=arrivals(discovery=False, multicast=(), udp=NONE),
    )
    (finding,) = bad(judge(replace(pc, look=UNSEEN), replace(shut, look=UNSEEN)))
    assert finding.what == "robot does not let in UDP 16571, 16572 to 16827 from this computer"
    assert finding.fix == (
        "on robot, with ufw: sudo ufw allow 16571/udp && sudo ufw allow 16572:16827/udp"
    )


def test_a_part_of_the_ports_is_told_from_all(pc: End, robot: End) -> None:
    (finding,) = bad(judge(pc, replace(robot, arrivals=arrivals(tcp=PART))))
    assert finding.level is Level.ERROR
    assert finding.why.startswith("TCP 16572 comes in and 16827 does not.")


def test_a_firewall_that_lets_in_answers_only_is_no_error(pc: End, robot: End) -> None:
    (finding,) = bad(judge(pc, replace(robot, arrivals=arrivals(udp=NONE))))
    assert finding.level is Level.WARNING
    assert "UDP 16572 to 16827" in finding.what


def test_known_peers_make_up_for_multicast(pc: End, robot: End) -> None:
    dark = replace(robot, arrivals=arrivals(multicast=()))
    asking = replace(pc, look=replace(SEEN, by_multicast=False))
    cause = only(judge(asking, dark), "multicast from this computer does not reach robot")
    assert cause.level is Level.ERROR
    assert "here: biosensor-gateway config lsl --for two-pc --peer 10.0.0.2\n" in cause.fix
    told = replace(asking, computer=replace(asking.computer, asks_the_other=True))
    assert only(judge(told, dark), "multicast from").level is Level.NOTE


def test_what_no_port_explains_is_said_as_such(pc: End, robot: End) -> None:
    (finding,) = bad(judge(replace(pc, look=UNSEEN), robot))
    assert finding.what.startswith("robot -> this computer: a test stream is not found in any way")
    assert "python3 -m lsl_to_ros.doctor" in finding.fix


@pytest.mark.parametrize(
    ("changed", "part"),
    [
        ({"session": "p01"}, "the LSL session is default on this computer and p01 on robot"),
        ({"ports": Ports(16571, 17000, 17255)}, "LSL's port of the first stream is 16572"),
        ({"ports": Ports(16600, 16572, 16827)}, "LSL's port of discovery is 16571"),
        ({"keeps_to_itself": True}, "LSL on robot keeps to its own computer"),
        ({"address": "172.17.0.2"}, "this computer reaches robot on 10.0.0.2, but that is 172."),
    ],
)
def test_what_is_set_up_differently(
    pc: End, robot: End, changed: dict[str, object], part: str
) -> None:
    other = replace(robot, computer=replace(robot.computer, **changed))  # type: ignore[arg-type]
    assert only(bad(judge(pc, other)), part)


def test_two_networks_and_a_slow_one_are_noticed(pc: End, robot: End) -> None:
    by_wifi = replace(pc, look=replace(SEEN, address="192.168.1.7", round_trip_s=0.3))
    found = judge(by_wifi, robot)
    note = only(found, "finds the streams of robot on 192.168.1.7, not on 10.0.0.2")
    assert note.level is Level.NOTE
    assert only(bad(found), "the clock's offset is known to 150 ms only")


def test_each_stream_that_is_not_seen_or_not_received_is_named(pc: End, robot: End) -> None:
    ecg, eda = (Stream(name, name, f"uid-{name}", "robot", 16572) for name in ("ecg", "eda"))
    sending = replace(robot, own=(ecg, eda))
    found = judge(replace(pc, seen=(ecg,)), sending)
    assert only(found, "does not see 1 of 2 streams of robot: eda").level is Level.ERROR
    assert only(found, "sees, but cannot receive from robot: ecg").level is Level.ERROR
    all_well = judge(replace(pc, seen=(ecg, eda), reached=("uid-ecg", "uid-eda")), sending)
    assert not bad(all_well)


def test_a_name_from_elsewhere_steers_no_terminal_and_no_line_is_too_long(
    pc: End, robot: End
) -> None:
    names = "\x1b[2Jrobot", "a-computer-with-a-name-as-long-as-windows-lets-it-be", "lab-pc"
    for name in names:
        other = replace(
            robot,
            computer=replace(robot.computer, name=name, system="win32"),
            arrivals=arrivals(udp=PART, tcp=NONE, multicast=()),
        )
        marked = tuple(CHECK.mark(each) for each in judge(pc, other))
        text = Checked(Report((CHECK,), marked, 1.0), (pc, other)).as_text("ascii", 80)
        assert "\x1b" not in text
        assert max(map(len, text.splitlines())) <= 80, text
        assert "UDP 16572 to 16827" in text


def test_the_options_that_exclude_each_other(run: Callable[..., Outcome]) -> None:
    for arguments in (("--answer", "--with", "robot"), ("--answer", "--only", "ports")):
        outcome = run(*arguments)
        assert outcome.code == 2
        assert "exclude one another" in " ".join(outcome.out.split())


@pytest.mark.nightly
def test_a_code_that_cannot_be_one_and_a_computer_that_is_unknown(
    run: Callable[..., Outcome],
) -> None:
    typed = run("--with", "127.0.0.1", "--code", "12", "--json")
    assert typed.code == 1
    assert "'12' is no code" in typed.json["findings"][0]["what"]
    unknown = run("--with", "no-such-host.invalid", "--code", "123456", "--json")
    assert unknown.json["findings"][0]["what"] == "no-such-host.invalid has no IPv4 address"
    assert unknown.json["ends"] is None
