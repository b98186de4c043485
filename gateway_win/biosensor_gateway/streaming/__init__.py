"""From a driver's samples to LSL: clock, pauses, counters, outlets, events."""
