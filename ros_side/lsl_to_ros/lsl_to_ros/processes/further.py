"""A further process of the node: a node of ROS that only publishes its share of the streams."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterable, Mapping

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.parameter import Parameter

from biosensor_common.ending import end_within
from biosensor_common.spec import DeviceIdentity
from lsl_to_ros.processes.link import Link, first_message
from lsl_to_ros.processes.mail import AllClaims, Claims, Report, Settings, Setup, Topics
from lsl_to_ros.processes.work import Work
from lsl_to_ros.topics.register import Claim

# Parameters and their services are those of the first process.
_NO_SERVICE = Parameter("start_type_description_service", value=False)


class _Names:
    """Names by what the first process says; :class:`~lsl_to_ros.topics.register.Names`."""

    def __init__(self, link: Link) -> None:
        self._link = link
        self.claims: Mapping[str, Claim] = {}
        self.lasting: frozenset[DeviceIdentity] = frozenset()

    def claim(self, own: Mapping[str, Claim]) -> None:
        """Say which streams this process has."""
        self._link.send(Claims(own))


class FurtherProcess(Node):
    """Publishes its share of the streams, under the names that the first process gives.

    Its own name begins with an underscore, so that ROS's tools do not list it.

    Parameters
    ----------
    end
        Of the pair of sockets to the first process.
    stopping
        Set when that is gone.

    Raises
    ------
    EOFError
        If that is gone already.
    """

    def __init__(self, end: socket.socket, stopping: threading.Event) -> None:
        setup: Setup = first_message(end)
        given = [Parameter.from_parameter_msg(each) for each in setup.parameters]
        super().__init__(
            f"_{setup.name}_{setup.share.index}",
            namespace=setup.namespace,
            start_parameter_services=False,
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
            parameter_overrides=[*given, _NO_SERVICE],
        )
        self._stopping = stopping
        self._listed: list[DiagnosticStatus] = []
        self._news = self.create_guard_condition(self._take_news)
        self._link = Link(end, self._wake)
        self._link.start()
        self._names = _Names(self._link)
        self._work = Work(self, setup.share, self._names, self._list_streams, self._report)
        self._work.start()

    def stop(self) -> None:
        """Close every inlet, and publish what has come."""
        self._work.stop()
        self._link.close()

    def _wake(self) -> None:
        """Have news taken, and end with the first process; called by the link's threads."""
        if self._link.is_closed:
            self._stopping.set()
            # Something hangs if it has not ended by then, and the streams would be published twice.
            end_within()
        self._news.trigger()

    def _take_news(self) -> None:
        for message in self._link.received():
            match message:
                case AllClaims(claims, lasting):
                    self._names.claims, self._names.lasting = claims, lasting
                    self._work.map_topics()
                case Settings(parameters):
                    self._set(Parameter.from_parameter_msg(each) for each in parameters)
                case _:
                    raise AssertionError(message)

    def _set(self, parameters: Iterable[Parameter]) -> None:
        for result in self.set_parameters(list(parameters)):
            if not result.successful:
                self._work.log.warn(result.reason)

    def _list_streams(self) -> None:
        entries = self._work.topics()
        if entries != self._listed:
            self._listed = entries
            self._link.send(Topics(entries))

    def _report(self, is_urgent: bool) -> None:
        self._link.send(Report(self._work.part(), is_urgent))
