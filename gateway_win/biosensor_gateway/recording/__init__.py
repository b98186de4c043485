"""Recordings: LabRecorder, its configuration, and the files."""
