"""The routes of the page's API, a module for each feature: models, handlers and state."""
