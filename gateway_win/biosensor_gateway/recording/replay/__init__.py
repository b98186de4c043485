"""Replays a recording as LSL streams, sample by sample with the original timing.

:mod:`.source` opens the recording; :mod:`.outlet` offers one stream with its recorded header, and
:mod:`.player` sends the samples of all streams on time and measures how late they are.
:mod:`.playback` combines these for the command and for :mod:`.player_process`, and refuses a replay
that could be mistaken for a real stream on the network. The player process plays for the page and
reports to it with messages.
"""

SLOWEST, FASTEST = 0.01, 1000.0
"""Limits of a replay's speed, in seconds of the recording in one second."""
