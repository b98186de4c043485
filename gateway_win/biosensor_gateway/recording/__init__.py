"""Everything about recordings: LabRecorder, its configuration, and the files."""
