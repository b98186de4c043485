"""The page: a local web server that shows and controls the agent."""
