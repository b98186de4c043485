"""``python -m biosensor_gateway.cli``."""

from biosensor_gateway.cli import main

main()
