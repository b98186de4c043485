"""The node as users know it: its first process, which has all that is there only once."""

from __future__ import annotations

import os
from collections.abc import Sequence
from time import monotonic

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter

from lsl_to_ros.lsl.share import Share
from lsl_to_ros.parameters import node as node_parameters
from lsl_to_ros.parameters.node import DIAGNOSTICS_PERIOD, PROCESSES
from lsl_to_ros.processes.child import ENDS_WITHIN_S, Child
from lsl_to_ros.processes.mail import AllClaims, Claims, Report, Settings, Setup, Topics
from lsl_to_ros.processes.work import LOOK_PERIOD_S, Work
from lsl_to_ros.reports.clock_pairs import CLOCK_PERIOD_S, ClockPairs
from lsl_to_ros.reports.processes import ProcessFacts
from lsl_to_ros.reports.reporting import Reporting
from lsl_to_ros.topics.register import Claim, Register


class LslToRos(Node):
    """One node for all streams; see the project's docs/ros-reference.md.

    With ``processes`` above 1 it starts further ones, and they share the streams. Names,
    parameters, ``/diagnostics`` and the list of streams stay here.

    Raises
    ------
    ConfigError
        If a parameter is wrong that decides which streams it serves.
    """

    def __init__(self) -> None:
        super().__init__(
            "lsl_to_ros",
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
        )
        given = self.get_parameters_by_prefix("").items()
        node_parameters.check({name: each.value for name, each in given})
        self._register = Register()
        self._declared: set[Claim] = set()
        share = Share(0, node_parameters.declare(self, PROCESSES))
        self._share = share
        # Before the rest, which is told of what changes.
        node_parameters.declare(self, DIAGNOSTICS_PERIOD)
        self._work = Work(self, share, self._register, self._list_streams, self._report)
        log, parameters = self._work.log, self._work.parameters
        self._reporting = Reporting(self, self._work.ros_time, log.warn)
        parameters.on_set(self._pass_on)
        news = self.create_guard_condition(self._take_news)
        self._children = [
            Child(Share(index, share.of), self._setup, news.trigger, log.warn)
            for index in range(1, share.of)
        ]
        self._told = 0
        self._clock_pairs = ClockPairs(self, log.warn)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        if self._children:
            self.create_timer(LOOK_PERIOD_S, self._look, clock=steady)
        self.create_timer(CLOCK_PERIOD_S, self._clock_pairs.look, clock=steady)
        self._work.start()

    def stop(self) -> None:
        """Close every inlet, and publish what has come; end the other processes."""
        self._clock_pairs.close()
        for child in self._children:
            child.close()
        until_s = monotonic() + ENDS_WITHIN_S
        self._work.stop()
        for child in self._children:
            child.wait(until_s)

    def _setup(self, share: Share) -> Setup:
        """Return what a further process starts with."""
        given = self.get_parameters_by_prefix("").values()
        parameters = [each.to_parameter_msg() for each in given if each.value is not None]
        return Setup(share, self.get_name(), self.get_namespace(), parameters)

    def _pass_on(self, parameters: Sequence[Parameter]) -> None:
        # Also the streams of other processes are declared here.
        for sentence in self._work.parameters.without_stream(parameters):
            self._work.log.warn(sentence)
        messages = [parameter.to_parameter_msg() for parameter in parameters]
        for child in self._children:
            child.send(Settings(messages))

    def _look(self) -> None:
        """See whether the other processes run, and who has which streams."""
        changed = [child for child in self._children if child.look()]
        for child in changed:
            child.send(self._all_claims())
        self._take_claims()
        if changed:
            self._report()

    def _take_news(self) -> None:
        """Take what the other processes have said."""
        for child in self._children:
            for message in child.received():
                self._take(child, message)
        self._take_claims()

    def _take(self, child: Child, message: object) -> None:
        match message:
            case Claims(claims):
                child.take_claims(claims)
            case Topics(entries):
                child.entries = entries
                self._list_streams()
            case Report(part, is_urgent):
                child.take_part(part)
                if is_urgent:
                    self._report()
            case _:
                raise AssertionError(message)

    def _take_claims(self) -> None:
        """Name topics anew if the streams of any process have changed, and tell all of it."""
        register, before = self._register, self._register.version
        for child in self._children:
            register.put(child.share.index, child.claims)
        if register.version != before:
            self._declare()
            self._work.map_topics()
        if register.version != self._told:
            self._told = register.version
            for child in self._children:
                child.send(self._all_claims())

    def _all_claims(self) -> AllClaims:
        return AllClaims(self._register.claims, self._register.lasting)

    def _declare(self) -> None:
        """Show the keys of streams of other processes, too, to ``ros2 param list``."""
        for claim in set(self._register.claims.values()) - self._declared:
            self._declared.add(claim)
            self._work.parameters.declare(claim.identity, claim.data_name, claim.chunk)

    def _list_streams(self) -> None:
        entries = [entry for child in self._children for entry in child.entries]
        self._reporting.list_streams([*self._work.topics(), *entries])

    def _report(self, _is_urgent: bool = True) -> None:
        own = ProcessFacts(self._share, os.getpid(), self._work.part())
        self._reporting.report([own, *(child.facts() for child in self._children)])
