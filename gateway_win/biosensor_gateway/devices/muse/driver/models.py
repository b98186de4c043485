"""Tells headbands apart, and chooses the preset that sends what is wanted.

Sources: BrainFlow's list of supported boards for what presets send; recordings of an Athena
[1]_, in which those of two digits send no light; the package openble-muse for serial numbers.

.. [1] OpenMuse, `tests/test_data`.
"""

from __future__ import annotations

from typing import NamedTuple

_MODELS = {
    "2": "Muse 2016",
    "4": "Muse 2",
    "5": "Muse S",
    "6": "Muse S",
    "7": "Muse S Athena",
}
MUSE_S = frozenset({"5", "6"})


class Preset(NamedTuple):
    """What a headband sends besides four channels of EEG, acceleration and rotation.

    Attributes
    ----------
    has_aux
        The inputs for electrodes of one's own.
    light
        Channels of light.
    """

    has_aux: bool
    light: int


CLASSIC = {
    "p20": Preset(True, 0),
    "p21": Preset(False, 0),
    "p50": Preset(True, 3),
    "p51": Preset(False, 3),
    "p60": Preset(True, 3),
    "p61": Preset(False, 3),
}
"""Of headbands before the Athena; the last two of a Muse S."""
ATHENA = {
    "p21": Preset(False, 0),
    "p1034": Preset(False, 8),
    "p1035": Preset(False, 4),
    "p1041": Preset(True, 16),
    "p1042": Preset(True, 16),
    "p1043": Preset(True, 8),
    "p1044": Preset(True, 8),
    "p1045": Preset(True, 4),
    "p1046": Preset(True, 4),
}


def model_of(serial: str) -> str:
    """Return the model by its serial number, empty if that tells nothing."""
    return _MODELS.get(serial[:1], "")


def classic_preset(serial: str, *, aux: bool, ppg: bool) -> str:
    """Return the preset of a Muse 2 or Muse S."""
    decade = 20 if not ppg else 60 if serial[:1] in MUSE_S else 50
    return f"p{decade if aux else decade + 1}"


def athena_preset(*, aux: bool, light: int) -> str:
    """Return the preset of an Athena with the fewest channels that has what is wanted."""
    fitting = [
        (preset.light, preset.has_aux, name)
        for name, preset in ATHENA.items()
        if preset.light >= light and preset.has_aux >= aux
    ]
    return min(fitting)[2]
