"""Waits for threads of the product without a limit, where a unit test must not depend on time.

The limits are for outputs that hang. In a unit test the thread writes to memory or to a file and
is done some time, however busy the computer is; a hang is found by the limit of the whole test.
"""

# pyright: reportPrivateUsage=false
from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager

import pytest

from biosensor_common.nonblocking_writer import NonblockingWriter
from biosensor_gateway.system import logs


@contextmanager
def patience_without_limit() -> Generator[None]:
    """Let logs be flushed, closed and opened, however long that takes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(NonblockingWriter, "flush", _flush)
        patch.setattr(NonblockingWriter, "close", _close)
        patch.setattr(logs, "OPENED_WITHIN_S", None)
        yield


def _flush(self: NonblockingWriter, limit_s: float) -> bool:
    del limit_s
    with self._changed:
        return self._changed.wait_for(self._is_idle)


def _close(self: NonblockingWriter, limit_s: float) -> bool:
    with self._changed:
        self._deadline_s = self._deadline_s or limit_s
        self._changed.notify_all()
    self._thread.join()
    return True
