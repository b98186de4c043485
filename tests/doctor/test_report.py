"""What is shown to a person, and the JSON that scripts rely on."""

from __future__ import annotations

import json

from biosensor_common.doctor.check import AGENT, Finding, Level, checks_of
from biosensor_common.doctor.report import Report, as_json, as_text

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
