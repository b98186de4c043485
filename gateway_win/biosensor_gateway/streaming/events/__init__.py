"""Events of the agent and its devices, as markers in the stream ``gateway/events``.

Each marker is one JSON object in a string, without blanks. Every one has

event
    One of :class:`EventKind`.
lsl_time
    LSL time in seconds at which it happened. The marker's stamp is the same time,
    but never before the stamp of an earlier marker: an event that is known late (a gap, by
    its first missing sample) is stamped after the events announced before it.

and those of a device also

sensor, unit, participant, label
    Identity of the device, as in the settings; the last two only if they are set.

Besides these:

=================== =========================================================================
``agent_started``   ``version``; ``clock``: ``lsl_s`` and ``unix_ns``, this computer's clocks at
                    one moment (:mod:`biosensor_common.ros_clock`); ``restarts`` and
                    ``last_end``, in words, if it had died and was started again
                    (``run --keep-alive``), as in each heartbeat
``agent_stopped``   Comes when the agent is asked to end; a killed one says nothing.
``heartbeat``       ``agent_started``: LSL time; ``session``: of LSL; ``devices``: state of each by
                    ``sensor/unit``, as ``biosensor-gateway status`` has it, or ``paused``;
                    ``problems``, where there are any, by ``sensor/unit``: what is wrong with
                    what a device sends or with its live features, each with a sentence,
                    ``what``, and ``last``, the LSL time of what has passed; under ``gateway``
                    what is wrong with the markers, and with live features of other streams;
                    ``clock``, as above. Where several people wear a virtual device of one
                    kind, ``sensor/unit (participant)`` stands for ``sensor/unit``
``connected``       ``connection``: its number since the agent's start; ``firmware_version``
                    where it is known
``disconnected``    ``reason``: ``lost``, ``silent``, ``absent``, ``garbage``, ``no_reply``,
                    ``refused``, …, or ``failed`` for a fault of the driver
``device_added``    It is in the settings that were read again, and was not before, or was
                    otherwise: its supervisor begins now
``device_removed``  It is no longer in them: its streams end
``gap_start``       At the newest sample before it, of any stream.
``gap_end``         At the first sample after it. ``lost``: missing samples by data name;
                    a stream that is not there has none, or none that can be counted.
                    ``paused``: true, where the gap ends in a pause
``clock_reanchored`` ``cause``: ``device_backward``, ``below``, ``far_above``,
                    ``stayed_above`` or ``device_restarted``; ``seconds`` by which the
                    mapping jumped, where it is known; ``times``, where it was more than
                    three times in a minute: the later ones are announced together
``streams_silent``  ``streams``: data names of streams that are due and do not come, while the
                    device is connected; ``seconds`` since their last data, without those in
                    which the agent did not run; ``remedy``: ``enabling again``,
                    ``connecting again``, or ``none`` where both have not helped and other
                    streams flow
``streams_back``    ``streams``: those of them that come again
``settings_changed`` ``changes``: before and after, as in
                    ``{"force.rate_hz":[10.0,20.0],"firmware_version":["1.0","1.1"]}``
``off_body``        ``channel`` of ``quality`` that says so
``on_body``         the same; also for the first time that it is known
``paused``          A participant's withdrawal: nothing is sent from here on. ``kept``: true
                    where the pause is older than the agent
``resumed``         ``send_from``: LSL time from which on samples are sent
=================== =========================================================================

``settings_changed`` tells what devices decide: nominal rates and what a device says of
itself, at the connection at which they differ from the one before. A device whose entry
in the settings file was changed is removed and added.

While a device is paused, no measurements of the body are reported, nor gaps,
because nothing is expected. How many samples were withheld is not said either: the
number of withheld beats is a heart rate.
"""

from __future__ import annotations

from enum import StrEnum, unique


@unique
class EventKind(StrEnum):
    """Kind of an event; see the table above."""

    AGENT_STARTED = "agent_started"
    AGENT_STOPPED = "agent_stopped"
    HEARTBEAT = "heartbeat"
    CONNECTED = "connected"
    DISCONNECTED = "disconnected"
    DEVICE_ADDED = "device_added"
    DEVICE_REMOVED = "device_removed"
    GAP_START = "gap_start"
    GAP_END = "gap_end"
    CLOCK_REANCHORED = "clock_reanchored"
    STREAMS_SILENT = "streams_silent"
    STREAMS_BACK = "streams_back"
    SETTINGS_CHANGED = "settings_changed"
    OFF_BODY = "off_body"
    ON_BODY = "on_body"
    PAUSED = "paused"
    RESUMED = "resumed"
