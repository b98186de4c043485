"""Configures LSL for this process."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

import pylsl

from biosensor_common.lsl_config import LslOverrides, effective_config, user_config_file


def configure_lsl(
    session_id: str, known_peers: Iterable[str], search_pause_s: float | None = None
) -> None:
    """Set the LSL configuration; call it before any other LSL call.

    Parameters
    ----------
    session_id
        Empty for the user's own.
    known_peers
        Hosts that multicast does not reach; empty names are none.
    search_pause_s
        See :class:`~biosensor_common.lsl_config.LslOverrides`.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` or ``MALFORMED``, for the user's own file.
    """
    peers = tuple(peer for peer in known_peers if peer)
    overrides = LslOverrides(session_id, peers, search_pause_s=search_pause_s)
    path = user_config_file(os.environ, Path.home(), Path.cwd())
    pylsl.set_config_content(effective_config(path, overrides))
