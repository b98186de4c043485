"""Reports the state of streams and devices: ``/diagnostics`` and the list of streams."""
