"""Where the time of a run went, and which files begin or take turns."""
