"""What is shown to a person, and the JSON that scripts rely on."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from biosensor_common.doctor import report as runner
from biosensor_common.doctor.check import (
    AGENT,
    Category,
    Check,
    Finding,
    Level,
    checks_of,
    error,
    note,
    ok,
)
from biosensor_common.doctor.report import Report, as_json, as_text, run_checks
from biosensor_common.doctor.windows_firewall import (
    Network,
    Protocol,
    Rule,
    Treatment,
    judge_rules,
    merged,
    read_rule,
)
from biosensor_common.lsl.api_file import Ports
from biosensor_gateway.doctor.context import Context
from tests.doctor.made_checks import made

CHECKS = checks_of(AGENT)
FINDINGS = (
    Finding(Level.OK, "all well", check="versions"),
    Finding(Level.ERROR, "a stream of \u2603 M\u00fcller\x1b[2J", "why", "one\ntwo", "streams"),
    Finding(Level.WARNING, "a warning", "why", "fix", "streams"),
    Finding(Level.NOTE, "a note", "why", "fix", "clock"),
)
REPORT = Report(CHECKS, FINDINGS, 4.25)
TEXT = f"""\
Program
  [ok]      versions: all well

Lab Streaming Layer
  [ERROR]   streams: a stream of ? M\u00fcller?[2J
            why: why
            fix: one
                 two
  [warning] streams: a warning
            why: why
            fix: fix

Computer
  [note]    clock: a note
            why: why
            fix: fix

{len(CHECKS)} checks in 4.2 s: 1 error, 1 warning, 1 note"""


def test_the_text_survives_a_western_console_and_steers_no_terminal() -> None:
    text = as_text(REPORT, "cp1252")
    assert text == TEXT
    assert text.encode("cp1252")


def test_the_text_survives_an_ascii_console() -> None:
    assert "M?ller" in as_text(REPORT, "ascii")


def test_no_problem_is_said() -> None:
    assert as_text(Report(CHECKS[:1], FINDINGS[:1], 0.1)).endswith(
        "1 check in 0.1 s: no problem found"
    )


def test_the_json_is_what_scripts_rely_on() -> None:
    text = as_json(REPORT)
    assert text.isascii()
    content = json.loads(text)
    assert list(content) == ["version", "good", "seconds", "checks", "counts", "findings"]
    assert content["version"] == 1
    assert content["good"] is False
    assert content["seconds"] == 4.25
    assert content["checks"] == [check.name for check in CHECKS]
    assert content["counts"] == {"ok": 1, "note": 1, "warning": 1, "error": 1}
    assert content["findings"][1] == {
        "check": "streams",
        "category": "Lab Streaming Layer",
        "level": "error",
        "what": FINDINGS[1].what,
        "why": "why",
        "fix": "one\ntwo",
    }
    assert all(list(each) == list(content["findings"][0]) for each in content["findings"])


# The rules of Windows' firewall, as the registry has them, and what they mean for LSL.
PORTS = Ports(16571, 16572, 16603)
EXE = r"C:\Program Files\Biosensor Gateway\biosensor-gateway.exe"
NAME = "Biosensor Gateway"
ORDINARY = Treatment()
# As netsh and Windows' own question write them.
INSTALLED = (
    "v2.31|Action=Allow|Active=TRUE|Dir=In|Profile=Domain|Profile=Private|RA4=LocalSubnet|"
    rf"RA6=LocalSubnet|App={EXE}|Name={NAME}|"
)
CANCELLED = (
    rf"v2.31|Action=Block|Active=TRUE|Dir=In|Protocol={{}}|Profile=Private|App={EXE.lower()}|"
    "Name=biosensor-gateway|Desc=biosensor-gateway|Defer=User|"
)
OF_PORTS = [
    "v2.31|Action=Allow|Active=TRUE|Dir=In|Protocol=17|LPort=16571|LPort2_10=16572-16603|Name=LSL|",
    "v2.31|Action=Allow|Active=TRUE|Dir=In|Protocol=6|LPort2_10=16572-16827|Name=LSL|",
]


def judged(
    *written: str,
    network: Network | None = Network.PRIVATE,
    of_domain: Sequence[str] = (),
    private: Treatment = ORDINARY,
) -> list[tuple[Level, str]]:
    rules = [rule for rule in map(read_rule, written) if rule is not None]
    rules += [replace(rule, is_local=False) for rule in map(read_rule, of_domain) if rule]
    found = judge_rules(rules, EXE, PORTS, network, {"Private": private})
    return [(each.level, each.what) for each in found]


def test_the_rule_of_the_installer_is_read() -> None:
    profiles = frozenset({"Domain", "Private"})
    assert read_rule(INSTALLED) == Rule(NAME, allows=True, program=EXE, profiles=profiles)
    assert judged(INSTALLED) == [(Level.OK, f"the firewall allows this program: {NAME!r}")]
    assert judged(INSTALLED, network=None)[0][0] is Level.OK


def test_variables_in_a_path_are_expanded() -> None:
    rule = read_rule(
        INSTALLED.replace(r"C:\Program Files", "%ProgramFiles%"),
        {"PROGRAMFILES": r"C:\Program Files"},
    )
    assert rule is not None
    assert rule.is_for(EXE.upper())
    assert not rule.is_for(EXE.replace("C:", "D:"))


@pytest.mark.parametrize(
    "other",
    [
        INSTALLED.replace("Dir=In", "Dir=Out"),
        INSTALLED.replace("Dir=In|", "Dir=In|Protocol=1|"),
        INSTALLED.replace("Dir=In|", "Dir=In|Svc=upnphost|"),
        INSTALLED.replace("Dir=In|", "Dir=In|AppPkgId=S-1-15-2-1|"),
        "v2.31",
        "",
    ],
)
def test_rules_for_something_else_are_left_out(other: str) -> None:
    assert read_rule(other) is None


@pytest.mark.parametrize(
    ("written", "why"),
    [
        (INSTALLED.replace("TRUE", "FALSE"), "is switched off"),
        (INSTALLED.replace("C:", "D:"), rf"is for {EXE.replace('C:', 'D:')}"),
        (
            INSTALLED.replace("|Profile=Private", ""),
            "applies only in domain networks",
        ),
        (INSTALLED.replace("Dir=In|", "Dir=In|LPort=80|"), "is for other ports or protocols"),
        (INSTALLED.replace("Action=Allow", "Action=Block"), "blocks"),
    ],
)
def test_a_rule_of_that_name_alone_is_no_proof(written: str, why: str) -> None:
    *blocking, (level, what) = judged(written)
    assert level is Level.NOTE
    assert what.startswith("no firewall rule allows TCP and UDP to this program")
    assert f"the rule {NAME!r} {why}" in what
    assert bool(blocking) == (why == "blocks")


def test_no_rule_at_all() -> None:
    what = "no firewall rule allows TCP and UDP to this program"
    assert judged() == [(Level.NOTE, what)]
    assert judged(INSTALLED, network=Network.PUBLIC)[0][0] is Level.NOTE


def test_rules_that_block_win_over_those_that_allow() -> None:
    found = judged(INSTALLED, CANCELLED.format(6), CANCELLED.format(17))
    assert [level for level, _ in found] == [Level.WARNING, Level.WARNING]
    assert "'biosensor-gateway' blocks TCP" in found[0][1]
    # Where it is not in force, and for ports that LSL does not use, it blocks nothing.
    assert judged(INSTALLED, CANCELLED.format(6), network=Network.DOMAIN)[0][0] is Level.OK
    of_others = CANCELLED.format("6|LPort=22345").replace(f"App={EXE.lower()}|", "")
    assert judged(INSTALLED, of_others)[0][0] is Level.OK
    everything = "v2.31|Action=Block|Active=TRUE|Dir=In|Name=Nobody|"
    assert judged(INSTALLED, everything)[0][0] is Level.WARNING


def test_rules_for_ports_let_every_program_in() -> None:
    assert judged(*OF_PORTS) == [(Level.OK, "the firewall allows this program: 'LSL'")]
    (found,) = judged(OF_PORTS[0])
    assert found == (Level.NOTE, "no firewall rule allows TCP to this program")
    half = OF_PORTS[1].replace("-16827", "-16580")
    assert judged(OF_PORTS[0], half) == [found]
    rpc = read_rule(OF_PORTS[1].replace("LPort2_10=16572-16827", "LPort=RPC"))
    assert rpc == Rule("LSL", allows=True, protocols=frozenset({Protocol.TCP}), ports=())


def test_rules_that_cannot_be_read() -> None:
    (found,) = judge_rules(None, EXE, PORTS, None, {})
    assert (found.level, "cannot be read" in found.what) == (Level.NOTE, True)
    assert "netsh advfirewall" in found.fix


def test_a_firewall_that_is_off_needs_no_rule() -> None:
    off = Treatment(is_on=False)
    ((level, what),) = judged(CANCELLED.format(6), private=off)
    assert (level, "is off in private networks" in what) == (Level.OK, True)
    # Of two kinds of network one is not.
    assert judged(private=off, network=None)[0][0] is Level.NOTE
    assert judged(INSTALLED, private=off, network=Network.DOMAIN)[0][0] is Level.OK


def test_nothing_is_right_where_everything_is_blocked() -> None:
    shut = Treatment(lets_in=False)
    ((level, what),) = judged(INSTALLED, private=shut)
    assert (level, "blocks all incoming connections in private networks" in what) == (
        Level.WARNING,
        True,
    )
    assert judged(INSTALLED, private=shut, network=Network.DOMAIN)[0][0] is Level.OK


def test_rules_of_a_pc_that_its_manager_does_not_merge_are_none() -> None:
    deaf = Treatment(heeds_local_rules=False)
    ((level, what),) = judged(INSTALLED, private=deaf)
    assert (level, "only the rules of this PC's administrator" in what) == (Level.WARNING, True)
    # What Windows' own question has blocked is not in force, either.
    allowed = (Level.OK, f"the firewall allows this program: {NAME!r}")
    blocked = CANCELLED.format(6)
    assert judged(INSTALLED, blocked, of_domain=[INSTALLED], private=deaf) == [allowed]
    assert judged(INSTALLED, of_domain=[blocked], private=deaf)[0][0] is Level.WARNING


OF_MANAGERS: list[tuple[dict[str, object], list[dict[str, object]], Treatment]] = [
    ({}, [{}, {}], ORDINARY),
    ({"EnableFirewall": 0}, [{}, {}], Treatment(is_on=False)),
    ({"EnableFirewall": 0}, [{"EnableFirewall": 1}, {}], ORDINARY),
    ({"EnableFirewall": 1}, [{}, {"EnableFirewall": 0}], Treatment(is_on=False)),
    ({"DoNotAllowExceptions": 1}, [{}, {}], Treatment(lets_in=False)),
    ({}, [{"AllowLocalPolicyMerge": 0}, {}], Treatment(heeds_local_rules=False)),
    ({}, [{"AllowLocalPolicyMerge": 1}, {"AllowLocalPolicyMerge": 1}], ORDINARY),
    # A PC cannot say this of itself.
    ({"AllowLocalPolicyMerge": 0}, [{}, {}], ORDINARY),
]


@pytest.mark.parametrize(("local", "managed", "treatment"), OF_MANAGERS)
def test_settings_of_who_manages_a_pc_come_first(
    local: dict[str, object], managed: list[dict[str, object]], treatment: Treatment
) -> None:
    assert merged(local, managed) == treatment


# Checks run side by side, and none of them can stop the others.


def run(*checks: Check) -> Report:
    return run_checks(checks, Context(Path("settings.toml"), Path("state")))


def good(_: Context) -> Iterator[Finding]:
    yield ok("it is there")


def raising(_: Context) -> Iterator[Finding]:
    yield ok("so far")
    raise ZeroDivisionError("a mistake")


@pytest.mark.nightly
def test_findings_are_in_the_order_of_the_checks_whoever_is_first() -> None:
    first = threading.Event()

    def waits(_: Context) -> Iterator[Finding]:
        assert first.wait(30.0)
        yield ok("second")

    def signals(_: Context) -> Iterator[Finding]:
        yield ok("first")
        first.set()

    report = run(made("waits", waits), made("signals", signals))
    assert [(each.check, each.what) for each in report.findings] == [
        ("waits", "second"),
        ("signals", "first"),
    ]
    assert report.is_good


@pytest.mark.nightly
@pytest.mark.parametrize("problem", [ZeroDivisionError("no"), SystemExit(3), KeyboardInterrupt()])
def test_a_check_that_raises_is_a_finding(problem: BaseException) -> None:
    def fails(_: Context) -> Iterator[Finding]:
        yield ok("so far")
        raise problem

    report = run(made("fails", fails), made("good", good))
    so_far, failed, there = report.findings
    assert (so_far.what, there.what) == ("so far", "it is there")
    assert (failed.check, failed.level) == ("fails", Level.WARNING)
    assert type(problem).__name__ in failed.what
    assert "biosensor-gateway doctor --only fails" in failed.fix


@pytest.mark.nightly
def test_a_check_that_cannot_be_imported_is_a_finding() -> None:
    gone = Check("no_such_module", Category.PROGRAM, "", "biosensor_common.no_such_module")
    report = run(gone, made("good", good))
    failed, there = report.findings
    assert "ModuleNotFoundError" in failed.what
    assert there.level is Level.OK


@pytest.mark.nightly
def test_checks_that_hold_each_other_up_get_more_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "_ON_A_BUSY_COMPUTER", 1000)
    released = threading.Event()

    def slow(_: Context) -> Iterator[Finding]:
        released.wait()
        yield ok("it is there")

    threading.Timer(1.0, released.set).start()
    report = run(*(made(name, slow, limit_s=0.3) for name in ("one", "other")))
    assert [each.level for each in report.findings] == [Level.OK, Level.OK]


@pytest.mark.nightly
def test_a_check_that_hangs_is_a_finding_behind_what_it_found() -> None:
    release = threading.Event()

    def hangs(_: Context) -> Iterator[Finding]:
        yield error("found before", "it matters", "fix it")
        release.wait()

    begun = time.monotonic()
    report = run(made("hangs", hangs, limit_s=0.3), made("good", good))
    release.set()
    found, late, there = report.findings
    assert (found.what, found.level) == ("found before", Level.ERROR)
    assert (late.check, late.what) == ("hangs", "the check did not end within 0.3 s")
    assert late.fix
    assert there.what == "it is there"
    # The limit is the requirement; its double is for a busy machine.
    assert 0.3 <= report.seconds <= time.monotonic() - begun
    assert not report.is_good


@pytest.mark.nightly
def test_checks_that_hang_wait_at_the_same_time() -> None:
    release = threading.Event()

    def hangs(_: Context) -> Iterable[Finding]:
        release.wait()
        return []

    report = run(*(made(f"hangs-{number}", hangs, limit_s=1.0) for number in range(8)))
    release.set()
    assert len(report.findings) == 8
    # One after the other they would take 8 s.
    assert report.seconds < 5.0


_WAITS_IN_A_POOL = """
import sys, time
from concurrent.futures import ThreadPoolExecutor
from tests.doctor.made_checks import made
import {module} as module
from {program} import main

def hangs(_):
    with ThreadPoolExecutor(1) as pool:
        pool.submit(time.sleep, 60.0)
        print("begun", flush=True)
    return []

module.{checks}
sys.argv = ["program", *{arguments}]
sys.exit(main())
"""


@pytest.mark.parametrize(
    "program",
    [
        {
            "module": "biosensor_gateway.cli.doctor",
            "program": "biosensor_gateway.cli",
            "checks": "_CHECKS = [made('hangs', hangs)]",
            "arguments": ["doctor"],
        },
        {
            "module": "lsl_to_ros.doctor.__main__",
            "program": "lsl_to_ros.doctor.__main__",
            "checks": "checks_of = lambda _: [made('hangs', hangs)]",
            "arguments": [],
        },
    ],
    ids=["agent", "node"],
)
@pytest.mark.seam
@pytest.mark.skipif(sys.platform == "win32", reason="a signal of POSIX")
def test_ctrl_c_ends_it_while_a_check_waits_in_a_pool_of_threads(
    program: dict[str, object], tmp_path: Path
) -> None:
    script = _WAITS_IN_A_POOL.format(**program)
    command = [sys.executable, "-c", script]
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGINT)
        begun = time.monotonic()
        try:
            assert process.wait(20.0) == 130
        finally:
            process.kill()
        assert time.monotonic() - begun < 5.0
        assert "Traceback" not in process.stderr.read()


def test_no_finding_above_ok_without_reason_and_remedy() -> None:
    assert ok("fine").fix == ""
    for why, fix in [("", "do"), ("because", "")]:
        with pytest.raises(ValueError, match="say why"):
            note("something", why, fix)


def test_every_check_of_the_table_is_there_and_ends_in_time() -> None:
    names = [check.name for check in CHECKS]
    assert len(set(names)) == len(names)
    for check in CHECKS:
        assert callable(check.load())
        assert check.title
        assert check.limit_s <= 15.0
