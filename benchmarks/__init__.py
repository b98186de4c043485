"""``make bench``: what the node and the agent cost and how late they are, against targets."""
