"""The server of the network's page says with what it has ended.

In a module without a browser, whose event loop runs as long as its module.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from biosensor_common.errors import ConfigError, TransportError, TransportReason
from biosensor_gateway.page.pages import NetworkPage
from biosensor_gateway.system.browser import WayIn

pytestmark = pytest.mark.nightly

REQUESTS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


@pytest.fixture(autouse=True)
def _signals() -> Iterator[None]:
    """Put back the handlers, of which the server has its own."""
    usual = {each: signal.getsignal(each) for each in REQUESTS}
    yield
    for each, handler in usual.items():
        signal.signal(each, handler)


def test_wrong_settings_end_it(tmp_path: Path) -> None:
    settings = tmp_path / "settings.toml"
    settings.write_text('[lsl]\nport_range = "wide"\n')
    with pytest.raises(ConfigError, match="port_range"):
        NetworkPage(settings, lambda _address: None).run()


def test_a_page_that_cannot_be_opened_ends_it(tmp_path: Path) -> None:
    def refuse(_way_in: WayIn) -> None:
        raise TransportError(TransportReason.UNAVAILABLE, "there is no browser")

    with pytest.raises(TransportError, match="no browser"):
        NetworkPage(tmp_path / "none.toml", refuse).run()
