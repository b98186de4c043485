"""What the operating system does for the agent: logs, its end, staying awake, files."""
