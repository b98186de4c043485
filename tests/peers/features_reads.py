"""Find events in real recordings by detectors of other people, and keep both for a comparison.

    python features_reads.py FILE.npz

NeuroKit2 and sleepecg look at whole recordings, forth and back in time. Signals are kept at
several rates: `ecg_1000` and so on; times are in s.
"""

from __future__ import annotations

import importlib
import sys
import warnings
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

# By name, since they are in the peers' environment only, where nothing is type-checked.
neurokit: Any = importlib.import_module("neurokit2")
sleepecg: Any = importlib.import_module("sleepecg")
resample: Any = importlib.import_module("scipy.signal").resample_poly

ECG_RATES, ECG_PART_S = (128, 130, 250, 512), 600
SKIN_RATES, BREATH_RATE = (4, 15, 128), 20


def _recording(name: str) -> Any:
    """Data that come with a package, which is not imported."""
    found = find_spec("systole")
    assert found is not None and found.origin is not None
    return np.load(Path(found.origin).parent / "datasets" / name).astype(float).ravel()


def _beats(values: Any, rate: int) -> tuple[Any, Any]:
    cleaned = neurokit.ecg_clean(values, rate)
    first = neurokit.ecg_peaks(cleaned, rate)[1]["ECG_R_Peaks"] / rate
    return first, sleepecg.detect_heartbeats(values, rate) / rate


def hearts() -> dict[str, Any]:
    """ECG at rest, ECG with an arrhythmia, and a pulse."""
    ecg = _recording("Task1_ECG.npy")
    kept: dict[str, Any] = {"ecg_1000": ecg}
    part = ecg[: ECG_PART_S * 1000]
    for rate in ECG_RATES:
        kept[f"ecg_{rate}"] = resample(part, rate, 1000, padtype="line")
    kept["ecg_neurokit"], kept["ecg_sleepecg"] = _beats(ecg, 1000)
    toy = sleepecg.get_toy_ecg()
    toy_values, toy_rate = np.asarray(toy[0], float), int(toy[1])
    kept[f"arrhythmia_{toy_rate}"] = toy_values
    kept["arrhythmia_neurokit"], kept["arrhythmia_sleepecg"] = _beats(toy_values, toy_rate)
    ppg = _recording("ppg.npy")
    kept["ppg_75"] = ppg
    kept["ppg_neurokit"] = neurokit.ppg_findpeaks(neurokit.ppg_clean(ppg, 75), 75)["PPG_Peaks"] / 75
    return kept


def skin() -> dict[str, Any]:
    """Skin conductance, and responses as they are by default: a tenth of the largest."""
    values = _recording("Task1_EDA.npy")
    kept = {f"skin_{rate}": resample(values, rate, 1000, padtype="line") for rate in SKIN_RATES}
    phasic = neurokit.eda_phasic(neurokit.eda_clean(values, 1000), 1000)["EDA_Phasic"]
    found = neurokit.eda_peaks(phasic, 1000)[1]
    lowest = neurokit.eda_peaks(phasic, 1000, amplitude_min=0.01)[1]
    height = np.asarray(lowest["SCR_Amplitude"])
    return {
        **kept,
        "skin_default": found["SCR_Peaks"] / 1000,
        "skin_005": lowest["SCR_Peaks"][height >= 0.05] / 1000,
    }


def breath() -> dict[str, Any]:
    """Breathing, and the ends of breathing in by two methods."""
    values = resample(_recording("Task1_Respiration.npy"), 1, 20, padtype="line")
    kept = {f"breath_{BREATH_RATE}": resample(values, BREATH_RATE, 50, padtype="line")}
    for method in ("khodadad2018", "biosppy"):
        cleaned = neurokit.rsp_clean(values, 50, method=method)
        kept[f"breath_{method}"] = (
            neurokit.rsp_peaks(cleaned, 50, method=method)[1]["RSP_Peaks"] / 50
        )
    # Of these the truth is known.
    for number, per_minute in enumerate((8, 12, 18, 30)):
        kept[f"simulated_{per_minute}"] = neurokit.rsp_simulate(
            duration=180,
            sampling_rate=BREATH_RATE,
            respiratory_rate=per_minute,
            method=("sinusoidal", "breathmetrics")[number in (1, 2)],
            random_state=number,
        )
    return kept


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    np.savez(sys.argv[1], **hearts(), **skin(), **breath())
