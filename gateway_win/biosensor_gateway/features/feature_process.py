"""Sends features in a separate process that ends with the agent, even after a crash.

Its standard input has one line of JSON with the LSL settings; the end of the input ends the
process. Each line of its output is a sentence for the agent's log.
"""

from __future__ import annotations

import contextlib
import sys
import threading

from biosensor_common.lsl.network import configure_lsl
from biosensor_common.process_limits import end_within
from biosensor_gateway.agent.feature_refusals import FeatureRefusals
from biosensor_gateway.features.live import Live
from biosensor_gateway.features.sources import Source
from biosensor_gateway.settings.models import LslSettings
from biosensor_gateway.settings.places import state_folder
from biosensor_gateway.system.child import first_line, when_input_ends


def send_for_another() -> int:
    """Compute and send until the input ends; return the exit code of this process."""
    line = first_line()
    if not line:
        return 0
    lsl = LslSettings.model_validate_json(line)
    configure_lsl(lsl.overrides)
    stopping = threading.Event()

    def end() -> None:
        stopping.set()
        end_within()

    when_input_ends(end)
    refusals = FeatureRefusals(state_folder())
    try:
        Live(_LogListener(), report=refusals.write).run(stopping)
    finally:
        refusals.close()
    return 0


class _LogListener:
    def found(self, source: Source) -> None:
        names = ", ".join(each.stream.data_name for each in source.features)
        self.refused(f"of {source.name}: {names}")

    def refused(self, sentence: str) -> None:
        _print_line(sentence)


def _print_line(sentence: str) -> None:
    line = " ".join(sentence.split())
    # nothing is dropped: the agent may have ended, which the end of the input reports as well
    with contextlib.suppress(OSError):
        sys.stdout.buffer.write(f"{line}\n".encode(errors="replace"))
        sys.stdout.buffer.flush()
