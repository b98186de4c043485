"""Logs what goes wrong while events are made, so that samples flow on."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec

import structlog

_Given = ParamSpec("_Given")

_log = structlog.get_logger("biosensor_gateway.events")


def log_errors(method: Callable[_Given, None]) -> Callable[_Given, None]:
    """Have a function raise nothing: its first failure is logged, later ones are passed over."""
    is_told = False

    @wraps(method)
    def guarded(*given: _Given.args, **named: _Given.kwargs) -> None:
        nonlocal is_told
        try:
            method(*given, **named)
        except Exception as error:  # noqa: BLE001 - whatever it is, samples flow on
            if not is_told:
                is_told = True
                name = method.__name__
                _log.exception("an event is not announced", of=name, error=str(error))

    return guarded
