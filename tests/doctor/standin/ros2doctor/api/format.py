"""The part of ros2doctor that shows text: on stderr, as warnings of Python."""

from __future__ import annotations

import warnings


def doctor_warn(msg: str) -> None:
    warnings.warn(msg, stacklevel=2)


def doctor_error(msg: str) -> None:
    warnings.warn(f"ERROR: {msg}", stacklevel=2)
