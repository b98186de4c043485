"""The page of the network: its server, its API, and what it shows."""
