"""Knows whether other processes live."""

from __future__ import annotations


def lives(process: object) -> bool:
    """Whether a process of that number lives; if that cannot be known, it does."""
    import psutil

    try:
        return psutil.Process(int(str(process))).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
    except (psutil.Error, ValueError, OverflowError):
        return True
