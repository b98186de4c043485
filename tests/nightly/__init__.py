"""Everything that is neither *unit* nor *check*, in parts that can be resumed: ``make nightly``."""
