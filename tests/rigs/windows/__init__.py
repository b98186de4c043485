"""Virtual Windows PCs, by Wine, on which the finished installer is run."""
