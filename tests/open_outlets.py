"""Outlets of this process that are still open, and how those of tests end."""

from __future__ import annotations

import gc
import inspect
import sys
import time
import weakref
from functools import cache

import pylsl

from biosensor_common.lsl.outlet import REST_S

_OF_THE_LAST_FAILURE = ("last_type", "last_value", "last_traceback", "last_exc")
_made: list[tuple[weakref.ref[pylsl.StreamOutlet], str]] = []


@cache
def watch_outlets() -> None:
    """Note every outlet that is made from now on, and end those of tests at rest, as ours are."""
    make, destroy = pylsl.StreamOutlet.__init__, pylsl.StreamOutlet.__del__
    # Not the one that is watched: in a run of all tiers, an outlet that an earlier test left in a
    # cycle may end during a unit test.
    sleep = inspect.unwrap(time.sleep)

    def noting(
        self: pylsl.StreamOutlet, info: pylsl.StreamInfo, *arguments: int, **named: int
    ) -> None:
        make(self, info, *arguments, **named)
        _made.append((weakref.ref(self), info.source_id() or info.name()))

    def rested(self: pylsl.StreamOutlet) -> None:
        # Those of our programs wait by themselves; one that was refused was never made.
        if type(self) is pylsl.StreamOutlet and hasattr(self, "obj"):
            sleep(REST_S)
        destroy(self)

    pylsl.StreamOutlet.__init__ = noting
    pylsl.StreamOutlet.__del__ = rested


def outlets_of(source_id: str) -> list[pylsl.StreamOutlet]:
    """Return the open outlets of one stream."""
    found = (ref() for ref, name in _made if name == source_id)
    return [outlet for outlet in found if outlet is not None]


def open_outlets() -> list[str]:
    """Return what is still open, by source_id."""
    if _still_open():
        # What a test put into a cycle, such as an error and what raised it, is no leak; nor
        # is what pytest keeps of a failed one, for a debugger.
        for name in _OF_THE_LAST_FAILURE:
            if hasattr(sys, name):
                delattr(sys, name)
        gc.collect()
    _made[:] = _still_open()
    return [name for _, name in _made]


def _still_open() -> list[tuple[weakref.ref[pylsl.StreamOutlet], str]]:
    return [one for one in _made if one[0]() is not None]
