"""``python -m biosensor_gateway.cli``."""

from biosensor_gateway.cli.app import main

main()
