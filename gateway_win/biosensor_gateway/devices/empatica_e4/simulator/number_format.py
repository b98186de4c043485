"""Numbers as a .NET program of the server's time writes them.

The general format: so many significant digits, no trailing zeros, and powers of ten
below 1e-4 and from the precision on. The marks are those of the Windows locale.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

_VALUE_DIGITS = 7
_STAMP_DIGITS = 15


@dataclass(frozen=True, slots=True)
class NumberFormat:
    """The marks of a locale.

    Parameters
    ----------
    decimal_mark
        ``,`` or ``.``.
    minus_sign
        ``-``, or U+2212 as some locales have it.
    digits
        From nought to nine.
    """

    decimal_mark: str = ","
    minus_sign: str = "-"
    digits: str = "0123456789"

    def value(self, number: float) -> str:
        """Write a measured value: single precision, G7."""
        return self._localised(f"{as_sent(number):.{_VALUE_DIGITS}g}")

    def stamp(self, unix_s: float) -> str:
        """Write a time: double precision, G15, which is steps of 10 us."""
        return self._localised(f"{unix_s:.{_STAMP_DIGITS}g}")

    def with_other_mark(self) -> NumberFormat:
        """Return the format of a locale with the other decimal mark."""
        return replace(self, decimal_mark="." if self.decimal_mark == "," else ",")

    def _localised(self, text: str) -> str:
        marked = text.upper().replace(".", self.decimal_mark).replace("-", self.minus_sign)
        return marked.translate(str.maketrans("0123456789", self.digits))


def as_sent(number: float) -> float:
    """Round a value to what `NumberFormat.value` can say; never -0."""
    return float(f"{float(np.float32(number)):.{_VALUE_DIGITS}g}") + 0.0
