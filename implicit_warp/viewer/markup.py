"""What the panel says in figures and colours, as HTML: text from elsewhere is escaped."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape

from implicit_warp.color_scales import ColorScale

_FAINT, _INK = "#868e96", "#212529"


def status(text: str, running: bool, figures: Sequence[tuple[str, str]]) -> str:
    """A line that says what is going on, and figures (name, value) below it."""
    dot = "#f08c00" if running else "#40a02b"
    cells = "".join(
        f'<div style="flex:1 1 0;min-width:0"><div style="color:{_FAINT};font-size:11px;'
        f'white-space:nowrap">{escape(name)}</div><div style="font-size:14px;font-weight:600;'
        f'color:{_INK};font-variant-numeric:tabular-nums;white-space:nowrap">{escape(value)}'
        "</div></div>"
        for name, value in figures
    )
    return (
        '<div style="padding:2px 12px 6px;line-height:1.4">'
        '<div style="display:flex;align-items:center;gap:7px;font-size:13px;min-height:20px">'
        f'<span style="flex:none;width:9px;height:9px;border-radius:5px;background:{dot}"></span>'
        f"<span>{escape(text)}</span></div>"
        f'<div style="display:flex;gap:10px;margin-top:4px">{cells}</div></div>'
    )


_LOCK = (
    '<path d="M5 13a2 2 0 0 1 2-2h10a2 2 0 0 1 2 2v6a2 2 0 0 1-2 2H7a2 2 0 0 1-2-2z"/>'
    '<path d="M8 11V7a4 4 0 0 1 8 0v4"/>'
)
_ARROWS = (
    '<path d="M18 9l3 3-3 3M15 12h6M6 9l-3 3 3 3M3 12h6M9 18l3 3 3-3"/>'
    '<path d="M12 15v6M15 6l-3-3-3 3M12 3v6"/>'
)


def handle_row(
    name: str, colour: tuple[int, int, int], weight: float, *, held: bool, active: bool
) -> str:
    """A handle's colour, kind, name and weight, on the left of a row of buttons: of no height
    itself."""
    rgb = f"rgb{colour}"
    fill, stroke = (rgb, "#fff") if active else ("transparent", rgb)
    times = "" if weight == 1.0 else f'<span style="color:{_FAINT}"> \u00d7{weight:g}</span>'
    return (
        '<div style="position:relative;height:0;z-index:1;pointer-events:none">'
        '<div style="position:absolute;left:11px;top:2px;width:100px;display:flex;gap:7px;'
        f'align-items:center;font-size:13px;font-weight:{600 if active else 450};color:{_INK}">'
        f'<svg width="20" height="20" viewBox="-4 -4 32 32" style="flex:none;border-radius:5px;'
        f'background:{fill}" fill="none" stroke="{stroke}" stroke-width="2.6" '
        f'stroke-linecap="round" stroke-linejoin="round">{_LOCK if held else _ARROWS}</svg>'
        '<span style="min-width:0;overflow:hidden;text-overflow:ellipsis;white-space:nowrap">'
        f"{escape(name)}{times}</span></div></div>"
    )


def legend(scale: ColorScale) -> str:
    """A colour scale with its values."""
    stops = ",".join(f"rgb({r},{g},{b})" for r, g, b, _ in scale.table[::15].tolist())
    ticks = "".join(
        f'<span style="position:absolute;left:{100 * at:.1f}%;transform:translateX(-50%)">'
        f"{escape(text)}</span>"
        for at, text in scale.ticks(4)
    )
    return (
        f'<div style="padding:0 18px 8px;font-size:11px;color:{_FAINT}">'
        f'<div style="margin-bottom:3px">{escape(scale.label)}</div>'
        f'<div style="height:10px;border-radius:3px;background:linear-gradient(90deg,{stops})">'
        f'</div><div style="position:relative;height:16px;margin-top:2px">{ticks}</div></div>'
    )


def report(text: str, good: bool | None = None, command: str = "") -> str:
    """What became of an export, line by line; green or red at its side if it is a verdict; and the
    command that does the same again."""
    side = {None: "#ced4da", True: "#40a02b", False: "#d6336c"}[good]
    again = (
        f'\nThe same mesh again:<br><code style="font-size:11px">{escape(command)}</code>'
        if command
        else ""
    )
    return (
        f'<div style="margin:0 12px 8px;padding:4px 9px;border-left:3px solid {side};'
        f"background:#f8f9fa;font-size:12px;line-height:1.45;white-space:pre-wrap;"
        f'overflow-wrap:anywhere">{_table(text)}{again}</div>'
    )


_ROW = re.compile(r"^  (\S.*?)\s{2,}(.*)\n?", re.MULTILINE)
"""A line of a text that is set as a table, as reports of checks are."""


def _table(text: str) -> str:
    """A text whose lines of a name and a value keep their columns in any font."""
    return _ROW.sub(
        rf'<span style="display:flex;gap:8px"><span style="flex:0 0 98px;color:{_FAINT}">\1</span>'
        r"<span>\2</span></span>",
        escape(text),
    )


def hint(text: str) -> str:
    """A line of advice."""
    return (
        f'<div style="padding:0 12px 6px;font-size:12.5px;line-height:1.35;color:{_FAINT}">'
        f"{text}</div>"
    )
