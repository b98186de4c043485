"""Plays a recording as LSL streams, sample by sample as it was recorded.

:mod:`.source` opens what is to be played; :mod:`.live` looks whether a real stream, for which a
played one could be taken, is on the network; :mod:`.outlet` offers one stream with the header as
it was recorded, and :mod:`.player` sends all of them in time, by :mod:`.timeline`;
:mod:`.lateness` counts how late that was. :mod:`.playing` puts these together, for the command
and for :mod:`.player_process`, which plays for the page and tells it by :mod:`.told`.
"""
