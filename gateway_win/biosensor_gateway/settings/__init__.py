"""The settings file: its models, its template, its problems; and secrets."""
