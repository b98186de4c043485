"""Computes features of raw streams that a robot can act on: beats, heart rate, skin responses ...

The detectors are pure classes that take samples and return events. Their results do not depend on
how a stream is cut into blocks. :mod:`.runs` splits a stream at gaps and has filters
with state, :mod:`.r_peaks` and :mod:`biosensor_gateway.pulses` find beats, :mod:`.heart` computes
rates, and :mod:`.skin`, :mod:`.breathing` and :mod:`.quality` do the rest. All limits, with their
sources, are in :mod:`.parameters`. :mod:`.chains` combines detectors for each type of stream, and
:mod:`.outputs` declares the streams of features.

:mod:`.sources` selects streams by their headers and writes the headers of features,
:mod:`.live` receives and sends LSL streams, and :mod:`.offline` does the same for a recording.
"""
