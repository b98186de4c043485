"""Uses the operating system for the agent: logs, its end, staying awake, files."""
