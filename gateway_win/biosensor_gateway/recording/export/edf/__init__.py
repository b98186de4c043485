"""BDF+ files, the form of EDF+ with 24 bits, one for each run of a regular stream.

:mod:`.bdf` is the form: ranges, data records and the header. :mod:`.file` writes one file, for
EDF and for EMG in BIDS, and :mod:`.exporter` goes over streams and runs. See
https://www.edfplus.info/specs/edfplus.html and
https://www.teuniz.net/edfbrowser/bdfplus%20format%20description.html.
"""
