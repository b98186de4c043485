"""Records LSL streams to an XDF file: by this computer itself, or by LabRecorder's window."""
