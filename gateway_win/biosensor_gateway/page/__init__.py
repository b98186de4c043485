"""The page: a web server of its own on this computer, which shows and steers the agent."""
