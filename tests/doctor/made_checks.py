"""Checks that are made for a test."""

from __future__ import annotations

from biosensor_common.doctor.check import Category, Check, Examine


class Made(Check):
    """A check that is not a module."""

    examine: Examine

    def load(self) -> Examine:
        return self.examine


def made(name: str, examine: Examine, limit_s: float = 30.0) -> Check:
    check = Made(name, Category.PROGRAM, name, "", limit_s)
    check.examine = examine
    return check
