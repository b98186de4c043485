"""Computes what a robot can act on from raw streams: beats, heart rate, responses of the skin ...

Pure classes first, which take samples and give events, the same for any cutting of a stream:
:mod:`.runs` cuts where samples are missing, :mod:`.filters` has filters with state, :mod:`.r_peaks`
and :mod:`.pulse` find beats, :mod:`.heart` makes rates of them, and :mod:`.skin`,
:mod:`.breathing`, :mod:`.activity` and :mod:`.quality` do the rest. All limits, with their sources,
are in :mod:`.thresholds`. :mod:`.chains` puts these together for each type of stream, and
:mod:`.outputs` declares what comes out.

:mod:`.sources` judges a stream's header, :mod:`.headers` writes those of what comes out,
:mod:`.live` reads LSL and sends LSL, and :mod:`.offline` does the same to a recording.
"""
