"""The interface of the network's page."""

from __future__ import annotations

from fastapi import FastAPI

from biosensor_gateway.page.static_files import PREFIX
from biosensor_gateway.page.network.models import NetworkView
from biosensor_gateway.page.network_page.source import NetworkSource
from biosensor_gateway.page.new_app import new_app


def network_api(source: NetworkSource) -> FastAPI:
    """Return the application that says what is seen."""
    app = new_app()

    @app.get(f"{PREFIX}/streams")
    async def streams() -> NetworkView:  # pyright: ignore[reportUnusedFunction]
        """Say which streams this computer sees, and how they are."""
        return source.status()

    return app
