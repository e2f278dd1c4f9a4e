"""Errors of callbacks, shown in the page with their remedy.

viser sends what a callback raises to the server's log only, where nobody looks.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable
from typing import Any

from fields.errors import InputError

LOG = logging.getLogger("implicit_warp.viewer")

SHOWN = (180, 40, 40)


def text_of(error: BaseException) -> tuple[str, str]:
    """Title and body for people."""
    if isinstance(error, InputError):
        return f"{error.argument}: {error.cause}", error.remedy
    kind = type(error).__name__
    return "Something went wrong", f"{kind}: {error}"


def tell(clients: Any, error: BaseException) -> None:
    """Show an error in one tab or in all of them.

    Args:
        clients: a viser client, or a server for all of its clients.
    """
    title, body = text_of(error)
    LOG.info("%s: %s", title, body, exc_info=not isinstance(error, InputError))
    targets = clients.get_clients().values() if hasattr(clients, "get_clients") else [clients]
    for client in targets:
        client.add_notification(title, body, color=SHOWN, auto_close_seconds=12.0)


def guarded(server: Any, callback: Callable[[Any], None]) -> Callable[[Any], None]:
    """A callback whose errors are shown in the tab that caused it.

    Events that the program made itself, by setting a value, are left out.
    """

    @functools.wraps(callback)
    def safe(event: Any) -> None:
        if event.client is None:
            return
        try:
            callback(event)
        except Exception as error:  # noqa: BLE001 - whatever it is, it is shown
            tell(event.client, error)

    return safe
