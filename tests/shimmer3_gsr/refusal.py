"""It refuses as every Shimmer does."""

from tests.shimmer.refusal import refusal

__all__ = ["refusal"]
