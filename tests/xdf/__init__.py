"""The check of recordings: on files written byte by byte, and on LabRecorder's own."""
