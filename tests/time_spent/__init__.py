"""Where the time of a run went, and how much of it each folder of tests may take."""
