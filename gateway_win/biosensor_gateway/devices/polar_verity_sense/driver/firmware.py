"""Sampling rates that firmware says wrong, as its vendor admits."""

from __future__ import annotations

import re
from collections.abc import Mapping

from biosensor_common.spec import DeviceInfo

_NUMBER = re.compile(r"\d+")
_VERITY_BEGIN, _VERITY_END = (1, 1, 5), (2, 1, 0)


def true_ppg_rates(info: DeviceInfo, *, sdk_mode: bool) -> Mapping[int, int]:
    """Return the rates at which light is really sampled, by those that a device says [Hz].

    A Verity Sense with firmware from 1.1.5 to before 2.1.0 says 135 Hz and sends 55, an OH1
    says 130 Hz and sends 135 [1]_. In the SDK mode rates are said right.

    Parameters
    ----------
    info
        What the device says of itself.
    sdk_mode

    References
    ----------
    .. [1] Polar BLE SDK, documentation/KnownIssues.md.
    """
    if sdk_mode:
        return {}
    if "OH1" in info.model:
        return {130: 135}
    if "Sense" in info.model and _VERITY_BEGIN <= _version(info) < _VERITY_END:
        return {135: 55}
    return {}


def _version(info: DeviceInfo) -> tuple[int, ...]:
    """Return the firmware's version; nothing if it is not told, which is before all others."""
    return tuple(int(number) for number in _NUMBER.findall(info.firmware_version)[:3])
