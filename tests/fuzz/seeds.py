"""Makes the seeds of the corpora from the vectors and recordings of the repository.

``python -m tests.fuzz.grow`` takes over those that reach what the corpora do not. A target of a
sensor's own folder brings its seeds itself.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path

from tests.fuzz import text_seeds
from tests.fuzz.contract import SENSORS, module_of
from tests.fuzz.seeding import Seeds


def _features() -> Seeds:
    """The head is what `features` makes of it: type, unit and rate; each part is of a shape."""
    sound = {"ecg": (0, 0, 130), "ppg": (1, 0, 64), "rr": (2, 2, 0), "gsr": (3, 1, 8)}
    sound |= {"breath": (4, 0, 20), "acc": (5, 4, 50), "ecg_2000": (0, 0, 2000)}
    shapes = {"ecg": 4, "ppg": 2, "rr": 0, "gsr": 3, "breath": 3, "acc": 5, "ecg_2000": 4}
    for name, (kind, unit, rate) in sound.items():
        head, shape = struct.pack("<BBf", kind, unit, rate), shapes[name]
        beats = [struct.pack("<BBe", shape, 255, 1.0 + at / 2) for at in range(3)]
        yield name, head + b"".join(beats)
        odd = [(0, math.nan), (6, 1.0), (7, 1.0), (24, 1.0), (32, -1.0), (40, 0.5), (1, 9.0)]
        broken = [struct.pack("<BBe", each, 9, size) for each, size in odd]
        yield f"{name}_broken", head + beats[0] + broken[0].join(broken) + beats[1]
        yield f"{name}_flat", head + struct.pack("<BBe", 0, 255, 5.0)
    for name, rate in (("rate", math.nan), ("slow", 3.0), ("fast", 2001.0)):
        yield f"odd_{name}", struct.pack("<BBf", 0, 0, rate)
    yield "odd_unit", struct.pack("<BBf", 3, 5, 8.0)


def seeds() -> dict[str, Seeds]:
    """Return the seeds of each target, with their names."""
    of_sensors = {name: module_of(name).seeds() for name in SENSORS}
    return {"features": _features(), **of_sensors, **text_seeds.seeds()}


def write_seeds(folder: Path) -> None:
    """Write all seeds, a folder for each target."""
    for target, found in seeds().items():
        place = folder / target
        place.mkdir(parents=True, exist_ok=True)
        for name, data in found:
            (place / name).write_bytes(data)
