"""Captures: recorded traffic between a driver and a real device, to be sent in and replayed."""
