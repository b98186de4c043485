"""What a user can set: the file, its models, its problems, and secrets."""
