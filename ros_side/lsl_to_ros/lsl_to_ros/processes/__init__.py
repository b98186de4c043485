"""The processes of the node, which share the streams."""
