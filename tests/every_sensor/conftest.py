"""The real programs, and a subscriber, as the end-to-end tests have them."""

from tests.e2e.conftest import listener, programs

__all__ = ["listener", "programs"]
