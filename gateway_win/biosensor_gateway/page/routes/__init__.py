"""What the page can ask for, a module for each feature: its models, its handlers, its state."""
