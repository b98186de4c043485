"""Plays a recording as LSL streams, sample by sample as it was recorded.

:mod:`.source` opens what is to be played; :mod:`.live` looks whether a real stream, for which a
played one could be taken, is on the network; :mod:`.outlet` offers one stream with the header as
it was recorded, and :mod:`.player` sends all of them in time, by :mod:`.timeline`;
:mod:`.lateness` counts how late that was.
"""
