"""Says how the streams and devices are: ``/diagnostics`` and the list of streams."""
