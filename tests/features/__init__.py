"""Features: pure classes in any cutting, headers that are wrong, and recordings."""
