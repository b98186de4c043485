"""Records LSL streams to an XDF file, on this computer or with LabRecorder's window."""
