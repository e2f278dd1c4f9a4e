"""Setting what the page's controls show."""

from __future__ import annotations

from typing import Any


def assign(control: Any, name: str, value: Any) -> None:
    """Set what a control shows, unless it shows it: every setting is a message to all tabs."""
    if getattr(control, name) != value:
        setattr(control, name, value)
