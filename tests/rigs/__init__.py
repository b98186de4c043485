"""Stand-ins for what a machine lacks, and made-up devices, shared by tests and programs."""
