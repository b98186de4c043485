"""Average a signal around the markers of one name, from a recording.

    python3 average_around_markers.py study.xdf --signal GSR --marker stimulus

Prints the mean of the signal's first channel in each tenth of a second from 1 s before to 5 s after
the markers, relative to its mean in the second before each marker.
Needs: pip install pyxdf
"""

import argparse
import json
import sys

import numpy as np
import pyxdf

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("file")
parser.add_argument("--signal", required=True, help="LSL type, such as GSR, ECG, HR")
parser.add_argument("--marker", required=True, help="the markers' text, without the note")
options = parser.parse_args()

# Losses stay visible: without dejittering, a gap in the stamps is a gap in the data.
streams, _ = pyxdf.load_xdf(options.file, dejitter_timestamps=False)
signals = [s for s in streams if s["info"]["type"][0] == options.signal and len(s["time_stamps"])]
if not signals:
    types = sorted({s["info"]["type"][0] for s in streams})
    sys.exit(f"There is no {options.signal} in {options.file}; there are {', '.join(types)}.")


def name(text):
    """Return the name of a marker; the gateway's own are JSON objects, others are plain text."""
    return json.loads(text)["marker"] if text.startswith("{") else text


moments = [
    time
    for stream in streams
    if stream["info"]["type"][0] == "Markers"
    for time, sample in zip(stream["time_stamps"], stream["time_series"], strict=True)
    if name(sample[0]) == options.marker
]
if not moments:
    sys.exit(f"There is no marker {options.marker!r} in {options.file}.")

edges = np.round(np.arange(-1.0, 5.05, 0.1), 1)
for signal in signals:
    times, values = signal["time_stamps"], np.asarray(signal["time_series"], float)[:, 0]
    curves = []
    for moment in moments:
        # Bins without a sample stay NaN: nothing is filled in where samples are missing.
        places = np.digitize(times - moment, edges) - 1
        curve = [
            np.nanmean(part) if (part := values[places == place]).size else np.nan
            for place in range(len(edges) - 1)
        ]
        before = np.array(curve[:10])
        if np.isfinite(before).any():
            curves.append(np.array(curve) - np.nanmean(before))
    print(
        f"{signal['info']['name'][0]}: {len(curves)} of {len(moments)} markers have a signal before"
    )
    if curves:
        average = np.ma.masked_invalid(np.array(curves)).mean(axis=0).filled(np.nan)
        for begin, value in zip(edges[:-1], average, strict=True):
            print(f"{begin:5.1f} s  {value:+.4f}")
