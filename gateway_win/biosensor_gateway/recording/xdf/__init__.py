"""Checks whether a LabRecorder recording (an XDF file) is sound, and salvages damaged ones.

:mod:`.container` splits the file into chunks, :mod:`.header` and :mod:`.samples` decode their
contents, :mod:`.recording` collects them by stream; :mod:`.figures` computes statistics of each
stream, :mod:`.verdict` derives findings from them, and :mod:`.report_text` formats both as text or
JSON. :mod:`.salvage` writes a repaired file.
"""
