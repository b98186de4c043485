"""Declares the streams of features: names, channels, units and algorithms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from biosensor_common.lsl.predicates import Predicate, any_of, ends_with
from biosensor_common.quantities import ContentType, Unit, spellings
from biosensor_common.spec import ChannelSpec, StreamSpec
from biosensor_common.table import channels, hardware, raw
from biosensor_gateway.features import parameters as at
from biosensor_gateway.features.breathing import BR_QUALITY
from biosensor_gateway.features.heart import HR_QUALITY
from biosensor_gateway.features.quality import REASONS
from biosensor_gateway.features.runs import BR_STATE, HR_STATE
from biosensor_gateway.features.skin import smoothing_delay_s

VERSION = "6"
"""Version of all algorithms; it changes whenever a value may differ for the same samples."""


def _of_each_window(labels: Mapping[str, Unit]) -> tuple[ChannelSpec, ...]:
    return tuple(
        ChannelSpec(f"{label}_{window_s:.0f}s", unit)
        for window_s in at.HRV_WINDOWS_S
        for label, unit in labels.items()
    )


_MS = Unit.MILLISECONDS
_HRV = _of_each_window(
    {"RMSSD": _MS, "SDNN": _MS, "pNN50": Unit.PERCENT, "valid": Unit.FRACTION}
) + _of_each_window(
    {
        "intervals": Unit.COUNTS,
        "covered": Unit.FRACTION,
        "quality": Unit.FRACTION,
        "motion": Unit.BOOLEAN,
    }
)
_BR_QUALITY = (
    *channels(Unit.COUNTS, "intervals"),
    *channels(Unit.FRACTION, "valid", "covered"),
    *channels(Unit.BREATHS_PER_MINUTE, "counted"),
)
_HR_QUALITY = (
    *channels(Unit.COUNTS, "intervals"),
    *channels(Unit.FRACTION, "valid", "covered", "quality"),
    *channels(Unit.BOOLEAN, "motion"),
)
_BESIDE = (
    *channels(Unit.SECONDS, "age"),
    *channels(Unit.FRACTION, "quality"),
    *channels(Unit.BOOLEAN, "motion"),
    *channels(Unit.COUNTS, "intervals"),
)
_BEATS = (*channels(Unit.SECONDS, "interval"), *channels(Unit.BOOLEAN, "artefact"))
_SCR = (
    *channels(Unit.MICROSIEMENS, "amplitude"),
    *channels(Unit.SECONDS, "rise_time"),
    *channels(Unit.MICROSIEMENS, "onset_level"),
)
_SQI = (*channels(Unit.FRACTION, "quality"), *channels(Unit.BOOLEAN, *REASONS, "motion"))


@dataclass(frozen=True, slots=True)
class Feature:
    """One stream of a feature."""

    name: str
    stream: StreamSpec
    algorithm: str
    # Length of the window of a value, in s; 0 for a single beat, breath or response.
    window_s: float
    delay_s: float  # Usual time from the event that a value describes to its decision, in s.
    every_s: float  # Longest time between two values while nothing is wrong, in s.

    @property
    def holds_s(self) -> float:
        """Age in seconds from which a value is outdated."""
        return self.every_s + self.delay_s + at.LUMP_S


def _heart(algorithm: str, delay_s: float) -> tuple[Feature, ...]:
    every_s = at.INTERVAL_S[1]
    return (
        Feature("beats", raw("beats", ContentType.RR, _BEATS), algorithm, 0, delay_s, every_s),
        Feature(
            "hr_live",
            raw("hr_live", ContentType.HR, channels(Unit.BEATS_PER_MINUTE, "HR")),
            f"{algorithm}; mean of the valid intervals, or of all if many are invalid",
            at.HR_WINDOW_S,
            delay_s,
            every_s,
        ),
        # A separate stream: hr_live, with one channel, is a plain number in ROS and must stay one.
        Feature(
            HR_QUALITY,
            hardware(HR_QUALITY, ContentType.QUALITY, _HR_QUALITY),
            "the intervals that hr_live averages, and the quality of its signal",
            at.HR_WINDOW_S,
            delay_s,
            every_s,
        ),
        Feature(
            "hrv_live",
            raw("hrv_live", ContentType.HRV, _HRV),
            f"{algorithm}; Task Force 1996, artefacts by Malik 1989",
            max(at.HRV_WINDOWS_S),
            delay_s,
            every_s,
        ),
    )


def _state(name: str, label: str, unit: Unit, window_s: float) -> Feature:
    stream = hardware(name, ContentType.QUALITY, (*channels(unit, label), *_BESIDE))
    algorithm = "the newest rate, its age, and the quality of its signal"
    return Feature(name, stream, algorithm, window_s, 0, at.STATE_EVERY_S)


_HR_STATE = _state(HR_STATE, "HR", Unit.BEATS_PER_MINUTE, at.HR_WINDOW_S)
_BR_STATE = _state(BR_STATE, "rate", Unit.BREATHS_PER_MINUTE, at.BR_WINDOW_S)


def _sqi(content_type: str, data_name: str, algorithm: str) -> Feature:
    stream = hardware(f"{data_name}_sqi", ContentType.QUALITY, _SQI)
    window_s = at.QUALITY_WINDOW_S[content_type]
    return Feature("sqi", stream, algorithm, window_s, 0, at.QUALITY_EVERY_S)


def _skin(rate: float) -> tuple[Feature, ...]:
    level = raw("scl", ContentType.GSR, channels(Unit.MICROSIEMENS, "SCL"))
    return (
        Feature("scl", level, "running median", at.SCL_WINDOW_S, 0, at.SCL_EVERY_S),
        Feature(
            "scr",
            raw("scr", ContentType.GSR, _SCR),
            "trough to peak, Boucsein 2012",
            0,
            smoothing_delay_s(rate) + at.SCR_FALLS_S,
            at.SCR_HOLDS_S,
        ),
        Feature(
            "scr_prominent",
            raw("scr_prominent", ContentType.GSR, _SCR),
            "as scr, of a tenth of the largest, Makowski 2021",
            at.SCR_LARGEST_S,
            1.2,
            at.SCR_HOLDS_S,
        ),
    )


def _breathing(unit: str) -> tuple[Feature, ...]:
    kind, algorithm = ContentType.RESPIRATION, "turning points, Khodadad 2018"
    breaths = raw("breaths", kind, channels(Unit.SECONDS, "interval"))
    depth = raw("breath_depth", kind, channels(unit, "depth"))
    every_s = at.BREATH_INTERVAL_S[1]
    rate = raw("br_live", ContentType.RESPIRATION_RATE, channels(Unit.BREATHS_PER_MINUTE, "rate"))
    return (
        Feature("breaths", breaths, algorithm, 0, 2, every_s),
        Feature("breath_depth", depth, algorithm, 0, 2, every_s),
        Feature("br_live", rate, algorithm, at.BR_WINDOW_S, 2, every_s),
        Feature(
            BR_QUALITY,
            hardware(BR_QUALITY, ContentType.QUALITY, _BR_QUALITY),
            "the intervals that br_live averages",
            at.BR_WINDOW_S,
            2,
            every_s,
        ),
    )


def _activity() -> tuple[Feature, ...]:
    stream = raw("activity_live", ContentType.ACTIVITY, channels(Unit.G, "MAD"))
    epoch_s = at.ACTIVITY_EPOCH_S
    return (Feature("activity_live", stream, "Vaha-Ypya 2015", epoch_s, 0, epoch_s),)


def features_of(
    content_type: str, data_name: str, unit: str, rate: float = 0.0
) -> tuple[Feature, ...]:
    """Return the features of a stream; empty for other types of streams.

    Parameters
    ----------
    data_name
        Lower-case ROS name of the stream, which the name of its quality begins with.
    unit, rate
        Of its values, from its header.
    """
    of_type: Mapping[str, tuple[Feature, ...]] = {
        ContentType.ECG: (*_heart("Hamilton 2002 on 8 to 20 Hz", 0.3), _HR_STATE),
        ContentType.PPG: (*_heart("Elgendi 2013", 0.35), _HR_STATE),
        ContentType.RR: _heart("intervals of the device", 0),
        ContentType.GSR: _skin(rate),
        ContentType.RESPIRATION: (*_breathing(unit), _BR_STATE),
        ContentType.ACCELEROMETER: _activity(),
    }
    judged = {
        ContentType.ECG: "Li 2008",
        ContentType.PPG: "Elgendi 2016",
        ContentType.GSR: "Kleckner 2018",
        ContentType.RESPIRATION: "power within 0.05 to 0.8 Hz",
    }
    if content_type not in of_type:
        return ()  # nothing is dropped: no feature is of its type
    features = of_type[ContentType(content_type)]
    if content_type in judged:
        algorithm = judged[ContentType(content_type)]
        features = (*features, _sqi(content_type, data_name, algorithm))
    return features


TYPES = (
    ContentType.ECG,
    ContentType.PPG,
    ContentType.RR,
    ContentType.GSR,
    ContentType.RESPIRATION,
    ContentType.ACCELEROMETER,
)
"""Types of streams with features, the best source of beats first."""
READ_TYPES = (*TYPES, ContentType.TEMPERATURE)
"""Types of streams that are received: temperature has no feature, but shows whether one is worn."""
READ_SPELLINGS = tuple(sorted(each for kind in READ_TYPES for each in spellings(kind)))
"""How programs spell these types."""


def feature_streams() -> Predicate:
    """Return a predicate for liblsl that matches streams of features, and none of our others."""
    features = [each for kind in TYPES for each in features_of(kind, "any", "none")]
    names = [each.stream.data_name for each in features if each.name != "sqi"]
    endings = dict.fromkeys([*(f"-{each}" for each in names), "_sqi"])
    return any_of(*(ends_with("source_id", each) for each in endings))
