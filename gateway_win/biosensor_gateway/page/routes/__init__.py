"""All that can be asked of the page, a module for each feature: models, handlers and state."""
