"""Says whether this process may open the files of one more inlet."""

from __future__ import annotations

from collections.abc import Collection

import pylsl

from biosensor_common import open_files
from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals
from lsl_to_ros.lsl.descriptions import about


class FileRoom:
    """Remembers which streams found no room, until they do or are gone."""

    def __init__(self, refusals: Refusals) -> None:
        self._refusals = refusals
        self._names: dict[str, tuple[str, str]] = {}

    @property
    def crowded_out(self) -> list[str]:
        """Names of the streams that are left out."""
        return [name for name, _ in self._names.values()]

    def has_room(self, info: pylsl.StreamInfo, opening: int) -> bool:
        """Whether a stream fits beside so many that are being opened."""
        if open_files.has_room((1 + opening) * open_files.INLET):
            self._forget(info.uid())
            return True
        if not opening:
            self._names[info.uid()] = info.name(), about(info)
            why = open_files.no_room()
            self._refusals.refuse(Refusal.NO_FILES, about=about(info), why=why)
        return False

    def forget_all_but(self, known: Collection[str]) -> None:
        """Forget streams that are gone; *known* are the uids of the others."""
        for uid in [uid for uid in self._names if uid not in known]:
            self._forget(uid)

    def _forget(self, uid: str) -> None:
        if uid in self._names:
            self._refusals.over(Refusal.NO_FILES, self._names.pop(uid)[1])
