"""Judges whether a LabRecorder recording (an XDF file) can be trusted.

:mod:`.container` cuts the file into chunks, :mod:`.header` and :mod:`.samples`
decode their contents, :mod:`.recording` gathers them by stream; :mod:`.measuring`
turns each stream into figures, :mod:`.judging` the figures into findings and
:mod:`.printing` both into text or JSON.
"""
