"""``python3 -m lsl_to_ros.doctor``: the checks of the node's computer, without ros2doctor."""

from __future__ import annotations

import argparse
import os
import sys

from biosensor_common import liblsl
from biosensor_common.doctor import network_check
from biosensor_common.doctor.check import NODE, Context, checks_of
from biosensor_common.doctor.network_check.sides import ANSWER_PORT
from biosensor_common.doctor.report import as_json, as_text, run_checks
from biosensor_common.process_limits import INTERRUPTED, INTERRUPTED_S, end_within, raise_limit
from biosensor_common.terminal import columns
from lsl_to_ros.doctor import GUIDE


def main() -> int:
    """Run the checks and print their findings; the exit code is 1 if there are errors."""
    raise_limit()
    liblsl.provide(os.environ)
    parser = argparse.ArgumentParser("python3 -m lsl_to_ros.doctor", description=__doc__)
    checks = checks_of(NODE)
    names = [check.name for check in checks]
    parser.add_argument("--only", action="append", choices=names, help="run this check only")
    parser.add_argument("--json", action="store_true", help="for scripts")
    parser.add_argument(
        "--answer", action="store_true", help="answer another computer's --with, once"
    )
    parser.add_argument("--with", dest="host", help="test the network to a computer with --answer")
    parser.add_argument("--code", help="for --with: the code that the other computer shows")
    parser.add_argument("--port", type=_port, default=ANSWER_PORT, help="for --answer and --with")
    given = parser.parse_args()
    if given.answer:
        return network_check.answer(Context(guide=GUIDE), NODE, given.port, as_json=given.json)
    if given.host:
        if not given.code:
            parser.error(f"--with needs --code and the code shown on {given.host}")
        return network_check.ask(
            Context(guide=GUIDE), NODE, given.host, given.port, given.code, as_json=given.json
        )
    chosen = [check for check in checks if not given.only or check.name in given.only]
    try:
        report = run_checks(chosen, Context(guide=GUIDE))
    except KeyboardInterrupt:
        # What waits for the network in a pool of threads would hold up the exit.
        end_within(INTERRUPTED_S, INTERRUPTED)
        return INTERRUPTED
    shown = as_text(report, sys.stdout.encoding or "ascii", columns(sys.stdout))
    text = as_json(report) if given.json else shown
    sys.stdout.write(text + "\n")
    return 0 if report.is_good else 1


def _port(text: str) -> int:
    if not (text.isdecimal() and 1024 <= int(text) <= 65535):
        raise argparse.ArgumentTypeError(f"{text} is not a port from 1024 to 65535")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
