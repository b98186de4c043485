"""Read an ECG from Lab Streaming Layer: units, rate, and samples on this computer's clock.

In one terminal: biosensor-gateway run --simulate polar_h10@P01
In another:      python3 read_a_stream.py
Needs: pip install pylsl
"""

import sys

import pylsl

SECONDS = 5.0

found = pylsl.resolve_byprop("type", "ECG", timeout=10.0)
if not found:
    sys.exit(
        "No ECG on the network. Start the agent, or see the page 'The lab PC' about firewalls."
    )

# LSL moves the sender's stamps onto this computer's clock; the samples stay as they were sent.
inlet = pylsl.StreamInlet(found[0], max_buflen=60, processing_flags=pylsl.proc_clocksync)
info = inlet.info(timeout=10.0)
units = info.get_channel_units()
print(f"{info.name()}: {info.nominal_srate():g} Hz, in {units[0] if units else 'unknown units'}")

stamps = []
while not stamps or stamps[-1] - stamps[0] < SECONDS:
    samples, times = inlet.pull_chunk(timeout=1.0)
    stamps.extend(times)
    if samples:
        age_ms = 1000 * (pylsl.local_clock() - times[-1])
        print(f"{len(samples):3d} samples, the newest {age_ms:4.0f} ms old: {samples[-1][0]:8.1f}")

print(f"measured rate: {(len(stamps) - 1) / (stamps[-1] - stamps[0]):.1f} Hz")
