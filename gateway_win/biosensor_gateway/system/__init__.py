"""What the operating system is asked for: logs, the end of the program, staying awake."""
