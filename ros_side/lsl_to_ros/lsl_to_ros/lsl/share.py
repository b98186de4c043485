"""Says which streams a process has, where several share those of the lab."""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256

import pylsl


@dataclass(frozen=True, slots=True)
class Share:
    """One of several equal parts of all streams, whichever they are.

    Attributes
    ----------
    index, of
        Which part of how many, from 0.
    """

    index: int = 0
    of: int = 1

    def has(self, info: pylsl.StreamInfo) -> bool:
        """Whether a stream belongs to it, the same whenever and wherever it is asked.

        A stream that comes back under its source_id is in the same part again, and so are two
        that claim to be the same.
        """
        if self.of == 1:
            return True
        source = info.source_id() or f"{info.name()}\n{info.hostname()}"
        digest = sha256(source.encode("utf-8", "surrogatepass")).digest()
        return int.from_bytes(digest[:8]) % self.of == self.index


ALL = Share()
"""What a process has that shares with no other."""
