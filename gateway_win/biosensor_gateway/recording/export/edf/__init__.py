"""Exports to BDF+, the 24-bit variant of EDF+: one file for each run of a regular stream.

:mod:`.bdf` has the format: ranges, data records and the header. :mod:`.exporter` writes one file,
also for EMG in BIDS, and iterates over streams and runs. See
https://www.edfplus.info/specs/edfplus.html and
https://www.teuniz.net/edfbrowser/bdfplus%20format%20description.html.
"""
