"""Judges whether a LabRecorder recording (an XDF file) can be trusted, and salvages what is cut.

:mod:`.framing` and :mod:`.container` cut the file into chunks, :mod:`.header` and
:mod:`.samples` decode their contents, :mod:`.sorting` and :mod:`.recording` gather them by
stream; :mod:`.measuring` turns each stream into figures, :mod:`.judging` the figures into
findings and :mod:`.printing` both into text or JSON. :mod:`.salvage` writes another file.
"""
