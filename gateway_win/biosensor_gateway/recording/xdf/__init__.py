"""Checks whether a LabRecorder recording (an XDF file) is sound, and salvages damaged ones.

:mod:`.framing` and :mod:`.container` split the file into chunks, :mod:`.header` and
:mod:`.samples` decode their contents, :mod:`.sorting` and :mod:`.recording` collect them by
stream; :mod:`.measuring` computes statistics of each stream, :mod:`.judging` derives findings from
them and :mod:`.printing` formats both as text or JSON. :mod:`.salvage` writes a repaired file.
"""
