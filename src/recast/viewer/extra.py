"""The optional package viser, which serves the page and writes replays."""

from __future__ import annotations

import socket
from contextlib import redirect_stdout
from io import StringIO
from typing import TYPE_CHECKING

from recast.errors import InputError

if TYPE_CHECKING:
    import viser

LOOPBACK = "127.0.0.1"


def require_viser() -> None:
    """Refuse early if the extra is missing.

    Raises:
        InputError: viser is not installed.
    """
    try:
        import viser  # noqa: F401
    except ImportError:
        raise InputError(
            "viser", "module", "is not installed", "pip install 'recast-sim[viewer]'"
        ) from None


def open_server(host: str = LOOPBACK, port: int = 8080) -> viser.ViserServer:
    """Start a viser server that prints nothing and cannot be shared through viser's tunnel.

    Args:
        host: address to listen on.
        port: TCP port; the next free one is taken if it is in use.

    Raises:
        InputError: viser is not installed, or the address is not one of this machine.
    """
    require_viser()
    import viser

    class Server(viser.ViserServer):
        def request_share_url(self, verbose: bool = True) -> str | None:
            """Nothing: a page must not open a tunnel to the outside."""
            return None

    _require_own(host)  # viser itself would wait for ever
    with redirect_stdout(StringIO()):
        server = Server(host=host, port=port, verbose=False)
    server.gui.configure_theme(
        control_width="large", dark_mode=True, show_logo=False, show_share_button=False
    )
    server.gui.main_panel.dock_right()
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop a server, again without a word."""
    with redirect_stdout(StringIO()):
        server.stop()


def _require_own(host: str) -> None:
    """Refuse an address that is none of this machine's.

    Raises:
        InputError: see above.
    """
    try:
        with socket.socket() as trial:
            trial.bind((host, 0))
    except OSError as error:
        raise InputError(
            "--host", host, f"cannot be listened on ({error.strerror or error})",
            "name an IPv4 address of this machine",
        ) from None  # fmt: skip
