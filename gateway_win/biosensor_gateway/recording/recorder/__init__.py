"""Steers LabRecorder by its remote control, and checks the file it writes.

The remote control answers ``OK`` to whatever it is told, knows no question, and
records every stream it sees. So whether a recording runs, and whether it was closed,
is read from the recording itself, where it can be reached from this computer.
"""
