"""Two computers with a firewall between them: which side, which port, which command.

The agent's computer asks, the node's answers, each with the real program; the firewall is
nftables of the kernel, as Linux systems set it up, and what is said to open it is run.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.doctor.outlets import Offered, arguments, running
from tests.doctor.test_computer_checks import environment
from tests.rigs.hosts.lan import NETWORK, Lan

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

CLOCK_OFFSET_S = 5000
LAB_PC, ROBOT = f"{NETWORK}.1", f"{NETWORK}.2"
_FIREWALL = """table inet filter {{
    chain input {{
        type filter hook input priority 0; policy accept;
        ct state established,related accept
        {rule}
    }}
}}
"""
_DISCOVERY = "udp dport 16571 drop"
_MULTICAST = "meta pkttype { broadcast, multicast } drop"
_TCP = "tcp dport 16572-16827 drop"
_EVERYTHING = "meta l4proto { tcp, udp } drop"


class Answer(NamedTuple):
    """What one side said."""

    code: int
    content: dict[str, Any]

    @property
    def errors(self) -> list[dict[str, Any]]:
        return [each for each in self.content["findings"] if each["level"] == "error"]


class Computers:
    """The two, and what they say of the network between them."""

    def __init__(self, lan: Lan, folder: Path) -> None:
        self.lab_pc, self.robot = lan["lab-pc"], lan["robot"]
        self._folder = folder

    def ask(self) -> tuple[Answer, Answer | None]:
        """Have the robot answer and the lab PC ask; return what both said, that of the PC first."""
        answering = subprocess.Popen(
            self.robot.command(sys.executable, "-m", "lsl_to_ros.doctor", "--answer", "--json"),
            env=environment(self.robot, self._folder),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        with answering:
            assert answering.stdout is not None
            assert answering.stderr is not None
            invitation = next(line for line in answering.stderr if "--code" in line)
            found = re.search(r"--with (\S+) .*--code (\d{6})", invitation)
            assert found is not None
            asked = self.reach(found[1], found[2])
            if asked.content["ends"] is None:
                answering.terminate()
                return asked, None
            answered = json.loads(answering.stdout.read())
        return asked, Answer(answering.returncode, answered)

    def reach(self, host: str, code: str) -> Answer:
        asking = ["doctor", "--with", host, "--code", code, "--json"]
        done = subprocess.run(
            self.lab_pc.command(sys.executable, "-m", "biosensor_gateway.cli", *asking),
            env=environment(self.lab_pc, self._folder),
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.stderr == ""
        return Answer(done.returncode, json.loads(done.stdout))


class Case(NamedTuple):
    """A firewall on one of the two; *command* names what is run then, before both ask again."""

    host: str = ""
    rule: str = ""
    is_opened: bool = False


CASES = {
    "open": Case(),
    "no multicast": Case("lab-pc", _MULTICAST),
    "no discovery": Case("robot", _DISCOVERY),
    "no tcp": Case("lab-pc", _TCP, is_opened=True),
    "nothing": Case("robot", _EVERYTHING),
}


class Said(NamedTuple):
    """What the two said, and once more after the command was run that the first one names."""

    asked: Answer
    answered: Answer | None
    command: str = ""
    again: tuple[Answer, Answer | None] | None = None


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Said]:
    """All cases at the same time, each with computers of its own: they mostly wait."""
    folders = {name: tmp_path_factory.mktemp("computers") for name in CASES}
    with ThreadPoolExecutor(len(CASES)) as pool:
        running = {name: pool.submit(_tried, CASES[name], folders[name]) for name in CASES}
        return {name: each.result() for name, each in running.items()}


def _tried(case: Case, folder: Path) -> Said:
    streams = arguments("default", [Offered("ecg", "ecg-1"), Offered("eda", "eda-1")], "site")
    with Lan({"lab-pc": 0, "robot": CLOCK_OFFSET_S}) as lan:
        pc = lan["lab-pc"]
        if case.rule:
            lan[case.host].run("nft", "-f", "-", text=_FIREWALL.format(rule=case.rule))
        with running(pc.command(sys.executable, *streams), environment(pc, folder)):
            computers = Computers(lan, folder)
            said = Said(*computers.ask())
            if not case.is_opened:
                return said
            command = typed(said.asked.errors[0]["fix"])
            lan[case.host].run("sh", "-c", command)
            return said._replace(command=command, again=computers.ask())


def typed(fix: str) -> str:
    """The command for plain nftables, without sudo: root runs it here."""
    (line,) = [each for each in fix.splitlines() if "nftables: " in each]
    return line.partition("nftables: ")[2].replace("sudo ", "")


def test_all_is_open(said: dict[str, Said]) -> None:
    asked, answered, *_ = said["open"]
    assert answered is not None
    assert (asked.code, answered.code) == (0, 0)
    whats = [each["what"] for each in asked.content["findings"]]
    assert {each["level"] for each in asked.content["findings"]} == {"ok"}
    # By IPv4, or by IPv6 if that answers first.
    seen = f"robot sees and opens 2 streams of this computer, on ({re.escape(LAB_PC)}|fe80:.*)"
    assert any(re.fullmatch(seen, each) for each in whats), whats
    assert any(each.startswith("robot sends no streams at the moment") for each in whats)
    there = answered.content["ends"]["here"]
    # Both know the same, each from its own side.
    assert asked.content["ends"]["there"] == there
    assert (there["computer"]["name"], there["computer"]["program"]) == ("robot", "node")
    assert there["arrivals"]["multicast"] == [LAB_PC]
    assert abs(there["look"]["offset_s"] - CLOCK_OFFSET_S) < 0.05
    assert {each["name"] for each in there["seen"]} == {"ecg", "eda"}


def test_multicast_does_not_get_through_one_way(said: dict[str, Said]) -> None:
    asked, answered, *_ = said["no multicast"]
    assert answered is not None
    assert (asked.code, answered.code) == (1, 1)
    cause, consequence = asked.errors
    assert cause["what"].startswith("multicast from robot does not reach this computer")
    assert "When asked for directly (KnownPeers), they are found" in cause["why"]
    assert cause["fix"] == (
        "on robot, start the node with: ros2 launch lsl_to_ros lsl_to_ros.launch.py "
        f'known_peers:="[{LAB_PC}]"'
    )
    assert consequence["what"] == "robot does not see 2 of 2 streams of this computer: ecg, eda"
    assert answered.errors[0]["fix"].startswith("here, start the node with")


def test_the_port_of_discovery_is_blocked_on_the_other_side(said: dict[str, Said]) -> None:
    asked = said["no discovery"].asked
    cause, *_ = asked.errors
    assert cause["what"] == "robot blocks UDP 16571 from this computer"
    assert cause["fix"].startswith("on robot, with ufw: sudo ufw allow 16571/udp\n")


def test_tcp_is_blocked_on_the_side_that_asks_until_the_command_opens_it(
    said: dict[str, Said],
) -> None:
    asked, answered, command, again = said["no tcp"]
    assert answered is not None
    assert (asked.code, answered.code) == (1, 1)
    cause, consequence = asked.errors
    assert cause["what"] == "this computer blocks TCP 16572 to 16827 from robot"
    assert "no data of this computer reaches robot" in cause["why"]
    assert consequence["what"] == "robot sees, but cannot receive from this computer: ecg, eda"
    assert answered.errors[0]["what"] == "lab-pc blocks TCP 16572 to 16827 from this computer"
    assert "tcp dport" in command
    assert "udp" not in command
    assert again is not None
    assert [each and each.code for each in again] == [0, 0]


def test_nothing_of_the_other_side_can_be_reached(said: dict[str, Said]) -> None:
    asked = said["nothing"].asked
    (cause,) = asked.errors
    assert asked.code == 1
    assert cause["what"] == f"nothing comes back from TCP 16827 of {ROBOT}"
    assert "None of its streams answers either" in cause["why"]
    assert f"on {ROBOT}, the command shown below the code there" in cause["fix"]
    assert "with ufw, for instance: sudo ufw allow 16572:16827/tcp" in cause["fix"]
    assert "or the other way round, here: biosensor-gateway doctor --answer" in cause["fix"]
