"""How slow and how fast a recording can be played, in seconds of it in one second."""

SLOWEST, FASTEST = 0.01, 1000.0
