"""Gives what a recording holds, piece by piece and on one clock; files may exceed the memory.

:mod:`.opening` opens a recording: it is read once, for where every chunk of samples lies, and then
only as far as somebody asks. A :class:`.stream.Stream` gives its samples on the recorder's clock,
to which `recording.xdf.sender_clock` brings them by the clock offsets in the file;
:mod:`.wall_clock` tells what time of day that was. :mod:`.choice` cuts streams, a span of time or
a participant out, and gives many streams in the order of time.
"""
