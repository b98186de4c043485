"""Records LSL streams to an XDF file by this program's own means.

:mod:`.program` is a process that takes the place of LabRecorder's program: it is given the same
words, says the same lines, and ends by the same line, so that :mod:`~biosensor_gateway.recording
.here` runs either. It is there for computers on which LabRecorder's does not record.
"""

NOTE = "Note: "
"""So a line begins that a person is told when the recording ends."""
