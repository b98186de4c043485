"""The other process of a check: LSL with a configuration of its own.

This module is also imported by the program that asks, so pylsl is not imported with it.
"""

from __future__ import annotations

import time

from biosensor_common.doctor.serving import Request, answer, serve
from biosensor_common.lsl.predicates import equals

_PERIOD_S = 0.1


def main() -> None:
    """Do what stdin says."""
    serve({"offer": _offer, "find": _find, "survey": _survey, "list": _list, "meet": _meet})


def _configure(request: Request) -> None:
    import pylsl

    pylsl.set_config_content(request["config"])


def _offer(request: Request) -> None:
    """Have an outlet, and send with it, until this process is ended."""
    import pylsl

    _configure(request)
    source_id = request["source_id"]
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo(source_id, "Doctor", 1, 0.0, "float32", source_id))
    answer({"open": True})
    while True:
        outlet.push_sample([0.0])
        time.sleep(_PERIOD_S)


def _find(request: Request) -> None:
    """Look for a stream."""
    import pylsl

    _configure(request)
    wanted = equals("source_id", request["source_id"])
    found = pylsl.resolve_bypred(wanted, 1, request["timeout_s"])
    answer({"found": bool(found)})


def _survey(request: Request) -> None:
    """Look at all streams."""
    _configure(request)
    from biosensor_common.doctor.survey import survey

    answer(survey(request["search_s"], request["listen_s"], request["listen_until_s"]))


def _list(request: Request) -> None:
    """List all streams, and listen to none."""
    _configure(request)
    from biosensor_common.doctor.survey import list_streams

    answer(list_streams(request["search_s"]))


def _meet(request: Request) -> None:
    """Look for a stream and receive it."""
    _configure(request)
    from biosensor_common.doctor.survey import meet

    answer(meet(request["source_id"], request["search_s"], request["listen_s"]))


if __name__ == "__main__":
    main()
