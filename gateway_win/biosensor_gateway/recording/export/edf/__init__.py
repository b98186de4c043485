"""BDF+ files, the form of EDF+ with 24 bits, one for each run of a regular stream.

:mod:`.layout` says how samples are put into data records, :mod:`.header` makes the header,
:mod:`.annotations` places what happened, :mod:`.records` makes bytes of numbers, and
:mod:`.exporter` goes over streams and runs. See https://www.edfplus.info/specs/edfplus.html and
https://www.teuniz.net/edfbrowser/bdfplus%20format%20description.html.
"""
