"""Reads a recording's samples block by block on one clock; files may exceed the memory.

:mod:`.opening` opens a recording: it reads the file once to index its chunks, and later only the
parts needed. A :class:`.stream.Stream` yields its samples on the recorder's clock, converted by
`recording.xdf.sender_clock` with the clock offsets in the file; :mod:`.wall_clock` converts to the
time of day. :mod:`.choice` selects streams, a time range or a participant, and merges streams in
time order.
"""
