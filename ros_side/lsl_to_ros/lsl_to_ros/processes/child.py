"""One further process, as the first one sees it: started, watched, started again."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from time import monotonic

from diagnostic_msgs.msg import DiagnosticStatus

from biosensor_common.child import STABLE_AFTER_S, Backoff, start, wait_or_kill
from lsl_to_ros.command_line import FURTHER
from lsl_to_ros.lsl.share import Share
from lsl_to_ros.processes.link import Link
from lsl_to_ros.processes.mail import Setup
from lsl_to_ros.reports.overload import name_of
from lsl_to_ros.reports.processes import ProcessFacts
from lsl_to_ros.reports.survey import Part
from lsl_to_ros.topics.register import Claim

FIRST_PAUSE_S = 0.5
# Until then a process that was started again has found its streams.
SETTLED_S = 10.0
# It reports once a second, and first has to start.
SILENT_AFTER_S, STARTS_WITHIN_S = 5.0, 20.0
# By then it hangs: a process that is only starved of the processor says something in between.
HUNG_AFTER_S, HUNG_AT_START_S = 10.0, 40.0
# More than this between two looks is time in which the first process did not run, either.
LONGEST_LOOK_S = 0.5
# What it has may have to be published first.
ENDS_WITHIN_S = 4.0
_BEGIN, _END = "--ros-args", "--"
# They come with what the first process starts the others with, as they are by then: a file of them
# names the node.
_OF_PARAMETERS = frozenset({"-p", "--param", "--params-file"})
_REMAPS = frozenset({"-r", "--remap"})
# Of whichever node.
_RENAMES = re.compile(r"(\w+:)?__(node|name|ns):=")


class Child:
    """Keeps one further process running: starts it again if it has died, or ends it if it hangs.

    Parameters
    ----------
    setup
        Returns what it starts with, as it is then.
    wake
        Called by a thread when it has said something or has ended.
    warn
        Called with a sentence when it has died, or was ended because it hangs.

    Attributes
    ----------
    entries
        Its part of the list of streams.
    """

    def __init__(
        self,
        share: Share,
        setup: Callable[[Share], Setup],
        wake: Callable[[], None],
        warn: Callable[[str], None],
    ) -> None:
        self.share = share
        self.entries: Sequence[DiagnosticStatus] = []
        self._setup, self._wake, self._warn = setup, wake, warn
        self._process: subprocess.Popen[bytes] | None = None
        self._link: Link | None = None
        self._part: Part | None = None
        self._claims: Mapping[str, Claim] = {}
        self._claims_before: Mapping[str, Claim] = {}
        self._begun_s = self._due_s = 0.0
        self._has_reported = False
        self._silent_s = self._looked_s = 0.0
        self._backoff = Backoff(FIRST_PAUSE_S)
        self._restarts = 0
        self._end = self._why_killed = ""
        self.start()

    @property
    def claims(self) -> Mapping[str, Claim]:
        """Its streams; for a while also those that it had before it was started again.

        Else the topics of others would be named anew, as if these streams were gone.
        """
        if self._process is None or monotonic() - self._begun_s < SETTLED_S:
            return {**self._claims_before, **self._claims}
        return self._claims

    def take_claims(self, claims: Mapping[str, Claim]) -> None:
        """Take in which streams it has."""
        self._claims = claims

    def take_part(self, part: Part) -> None:
        """Take in its report."""
        self._part = part
        self._has_reported, self._silent_s = True, 0.0

    def start(self) -> None:
        """Start it, or try again later if the system has no process or descriptor left."""
        self._begun_s = self._looked_s = monotonic()
        self._has_reported, self._silent_s, self._why_killed = False, 0.0, ""
        try:
            self._start(self._setup(self.share))
        except OSError as error:
            self._failed(f"cannot be started ({error})")

    def _start(self, setup: Setup) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            try:
                self._process = _popen(theirs.fileno(), setup.name)
            except OSError:
                ours.close()
                raise
        self._link = Link(ours, self._wake)
        self._link.start()
        self._link.send(setup)

    def send(self, message: object) -> None:
        """Tell it something; nothing happens while it does not run, for it starts with all."""
        if self._link is not None:
            self._link.send(message)

    def received(self) -> Sequence[object]:
        """Return what it has said."""
        return [] if self._link is None else list(self._link.received())

    def look(self) -> bool:
        """See whether it runs, start it again when it is time; return whether either happened.

        One that hangs is killed, and its end is seen by a later look.
        """
        now = monotonic()
        self._silent_s += min(now - self._looked_s, LONGEST_LOOK_S)
        self._looked_s = now
        if self._process is not None:
            self._kill_if_hung(self._process)
            return self._see_end(self._process)
        if now < self._due_s:
            return False
        self._restarts += 1
        self.start()
        return True

    def facts(self) -> ProcessFacts:
        """Return how it is."""
        pid = self._process.pid if self._process else 0
        missing = self._missing()
        return ProcessFacts(
            share=self.share,
            pid=pid,
            part=self._part,
            trouble=missing or self._recovered(),
            is_gone=bool(missing),
            restarts=self._restarts,
        )

    def _missing(self) -> str:
        """Say why it does not do its work; empty if it does, or starts for the first time."""
        if self._process is None:
            left_s = max(0.0, self._due_s - monotonic())
            return f"{self._end}; it is started again in {left_s:.0f} s"
        if self._silent_s > (SILENT_AFTER_S if self._has_reported else STARTS_WITHIN_S):
            return f"{name_of(self.share)} has said nothing for {self._silent_s:.0f} s"
        is_starting_again = self._end and not self._has_reported
        return f"{self._end}; it is being started again" if is_starting_again else ""

    def _recovered(self) -> str:
        """Say that it was started again; empty if it was not lately."""
        ran_s = monotonic() - self._begun_s
        is_recent = self._end and ran_s < STABLE_AFTER_S
        return f"{self._end}, and was started again {ran_s:.0f} s ago" if is_recent else ""

    def close(self) -> None:
        """Let it end."""
        if self._link is not None:
            self._link.close()

    def wait(self, until_s: float) -> None:
        """Wait for its end until a monotonic time, then kill it."""
        process = self._process
        if process is None:
            return
        wait_or_kill(process, max(0.0, until_s - monotonic()))

    def _kill_if_hung(self, process: subprocess.Popen[bytes]) -> None:
        limit_s = HUNG_AFTER_S if self._has_reported else HUNG_AT_START_S
        if self._silent_s > limit_s and not self._why_killed:
            self._why_killed = f"said nothing for {self._silent_s:.0f} s and was ended"
            process.kill()

    def _see_end(self, process: subprocess.Popen[bytes]) -> bool:
        code = process.poll()
        if code is None:
            return False
        self._claims_before, self._claims = self.claims, {}
        self.close()
        self._process = self._link = None
        how = f"was ended by signal {-code}" if code < 0 else f"ended with exit code {code}"
        self._failed(self._why_killed or how)
        return True

    def _failed(self, how: str) -> None:
        now = monotonic()
        self._due_s = now + self._backoff.next_s(now - self._begun_s)
        self._end = f"{name_of(self.share)} {how}"
        self._warn(f"{self._end}; its streams are not published until it is started again")


def _popen(descriptor: int, name: str) -> subprocess.Popen[bytes]:
    return start(
        [
            *(sys.executable, "-P", "-m", "lsl_to_ros.node", FURTHER, str(descriptor)),
            *for_further(sys.argv[1:], name),
        ],
        pass_fds=[descriptor],
        stdout=None,
        stderr=None,
    )


def for_further(arguments: Sequence[str], name: str) -> list[str]:
    """Return the arguments without parameters, and without the names of node and namespace.

    What is left are the remappings of topics, levels of the log, the enclave, and such.

    Parameters
    ----------
    name
        Of the node; a remapping for it alone is to hold for a further process, which has
        another name.
    """
    return list(_handed_on(iter(arguments), name))


def _handed_on(arguments: Iterator[str], name: str) -> Iterator[str]:
    is_ros = False
    for argument in arguments:
        is_ros = argument == _BEGIN or (is_ros and argument != _END)
        if is_ros and argument in _OF_PARAMETERS:
            next(arguments, None)
        elif is_ros and argument in _REMAPS:
            rule = next(arguments, "")
            if not _RENAMES.match(rule):
                yield from (argument, rule.removeprefix(f"{name}:"))
        else:
            yield argument
