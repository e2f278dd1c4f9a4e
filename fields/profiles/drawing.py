"""Filled shapes of an SVG file.

What is read: path, rect, circle, ellipse, polygon and polyline, in groups, nested svg, switch, a
and through use; the transform attribute; fill, fill-rule, display and visibility, as attributes, in
style attributes and in class rules of style elements. Path data is parsed by fontTools.

What is not: strokes, colours (every fill counts as material, white too), gradients' transparency
and units other than pixels. What would change the shape and is not read is an error: text, clipping
paths, masks and referenced files.
"""

from __future__ import annotations

import math
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from fields import arguments, notation
from fields.errors import InputError, needing
from fields.field import Field, make_field
from fields.profiles.curves import Contour, straight
from fields.profiles.filling import FillRule, Shape, filled
from fields.profiles.outline import outline_body
from fields.profiles.pens import drawn_contours

Matrix = NDArray[np.float64]
"""An affine map of the plane `(3, 3)`."""

_GROUPS = ("svg", "g", "a", "switch")
_UNREADABLE = ("text", "image", "foreignObject")
_QUARTER = 4 / 3 * math.tan(math.pi / 8)
"""Length of the handles of a cubic segment for a quarter of the unit circle (error 2.7e-4)."""
_DEEPEST = 64


def svg(
    path: str | os.PathLike[str], width: float | None = None, tolerance: float | None = None
) -> Field:
    """A profile: the filled shapes of an SVG file, united, centred at the origin, y upwards.

    The module's docstring lists what is read. The field is an exact distance to chords of the
    curves, within the tolerance.

    Args:
        path: of the file.
        width: of what is filled; None keeps the file's user units.
        tolerance: the largest distance of the curves from the chords, in the units of the result;
            None for 1/1000 of the longer side.

    Raises:
        InputError: the file does not exist, is no SVG, has something that cannot be read, or fills
            nothing.
        MissingDependency: fontTools is not installed, and the file has path data.
    """
    source = Path(path)
    accuracy = None if tolerance is None else arguments.positive("tolerance", tolerance)
    wanted = None if width is None else arguments.positive("width", width)
    shapes = list(_Drawing(source).shapes())
    if wanted is not None and shapes:
        # The chords of the wanted tolerance need the scale first, which coarse ones give.
        rough = np.concatenate(filled("path", str(source), shapes, None))
        factor = wanted / float(np.ptp(rough[:, 0]))
        shapes = [([factor * contour for contour in item], rule) for item, rule in shapes]
    polygons = filled("path", str(source), shapes, accuracy)
    corners = np.concatenate(polygons)
    center = (corners.min(axis=0) + corners.max(axis=0)) / 2
    body = outline_body([polygon - center for polygon in polygons])
    given = {"path": path, "width": width, "tolerance": tolerance}
    return make_field(body, notation.recorded("svg", (), given, notation.defaults(svg)))


class _Style(NamedTuple):
    """What an element hands on to those in it."""

    matrix: Matrix
    fill: str = "black"
    rule: str = "nonzero"
    visibility: str = "visible"


class _Drawing:
    """The shapes of one file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        if not path.is_file():
            raise InputError("path", str(path), "there is no such file", "check the path")
        try:
            self._root = ElementTree.parse(path).getroot()
        except (ElementTree.ParseError, UnicodeDecodeError, ValueError) as error:
            self._refuse(f"it is not readable as XML ({error})", "export it again as plain SVG")
        if _tag(self._root) != "svg":
            self._refuse(f"its root is <{_tag(self._root)}>, not <svg>", "pass an SVG file")
        self._by_id = {item.get("id"): item for item in self._root.iter() if item.get("id")}
        self._classes = _class_rules(self._root)

    def shapes(self) -> Iterator[Shape]:
        """Every filled element's contours in user units, y upwards."""
        upwards = np.diag([1.0, -1.0, 1.0])
        yield from self._walk(self._root, _Style(upwards), 0)

    def _walk(
        self, element: ElementTree.Element, outer: _Style, depth: int, used: bool = False
    ) -> Iterator[Shape]:
        properties = self._properties(element)
        if properties.get("display") == "none":
            return
        for name in ("clip-path", "mask"):
            if properties.get(name, "none") != "none":
                self._refuse(f"it uses {name}", "apply it to the shapes in a drawing program")
        if depth > _DEEPEST:
            self._refuse("its elements are nested too deeply, or use each other", "flatten it")
        style = _Style(
            outer.matrix @ self._transform(element.get("transform", "")),
            properties.get("fill", outer.fill),
            properties.get("fill-rule", outer.rule),
            properties.get("visibility", outer.visibility),
        )
        tag = _tag(element)
        is_drawn = style.visibility == "visible" and style.fill not in ("none", "transparent")
        if tag in ("svg", "symbol") and depth > 0 and {"viewBox", "x", "y"} & properties.keys():
            self._refuse(f"a <{tag}> in it has a place or view of its own", "flatten it")
        if tag in _GROUPS or (used and tag == "symbol"):
            for child in element:
                yield from self._walk(child, style, depth + 1)
        elif tag == "use":
            yield from self._used(element, style, depth)
        elif tag in _UNREADABLE and style.visibility == "visible":
            self._refuse(f"it has a <{tag}> element", "convert it to paths in a drawing program")
        elif tag in _SHAPES and is_drawn:
            contours = self._contours(element, tag)
            linear, offset = style.matrix[:2, :2], style.matrix[:2, 2]
            placed = [contour @ linear.T + offset for contour in contours]
            rule: FillRule = "evenodd" if style.rule == "evenodd" else "nonzero"
            yield placed, rule

    def _used(self, element: ElementTree.Element, style: _Style, depth: int) -> Iterator[Shape]:
        link = element.get("href") or element.get("{http://www.w3.org/1999/xlink}href") or ""
        target = self._by_id.get(link.removeprefix("#")) if link.startswith("#") else None
        if target is None:
            self._refuse(f"it uses {link!r}, which is not in it", "flatten it")
        shift = np.eye(3)
        shift[:2, 2] = self._number(element, "x"), self._number(element, "y")
        moved = style._replace(matrix=style.matrix @ shift)
        yield from self._walk(target, moved, depth + 1, used=True)

    def _properties(self, element: ElementTree.Element) -> dict[str, str]:
        """Attributes, overruled by class rules, overruled by the style attribute."""
        found = {key: value.strip() for key, value in element.attrib.items()}
        for name in element.get("class", "").split():
            found.update(self._classes.get(name, {}))
        found.update(_declarations(element.get("style", "")))
        return found

    def _transform(self, text: str) -> Matrix:
        matrix = np.eye(3)
        for name, inside in re.findall(r"(\w+)\s*\(([^)]*)\)", text):
            values = [float(v) for v in re.findall(_NUMBER, inside)]
            try:
                matrix = matrix @ _TRANSFORMS[name](*values)
            except (KeyError, TypeError):
                self._refuse(f"it has the transform {text!r}", "write it as matrix(a b c d e f)")
        return matrix

    def _contours(self, element: ElementTree.Element, tag: str) -> list[Contour]:
        if tag == "path":
            with needing("fonttools", "an SVG drawing"):
                from fontTools.svgLib.path import parse_path
            try:
                return drawn_contours(lambda pen: parse_path(element.get("d", ""), pen))
            except (ValueError, IndexError, TypeError, AttributeError, AssertionError) as error:
                self._refuse(f"it has path data that cannot be read ({error})", "export it again")
        if tag in ("polygon", "polyline"):
            values = [float(v) for v in re.findall(_NUMBER, element.get("points", ""))]
            points = np.array(values[: len(values) // 2 * 2]).reshape(-1, 2)
            return [straight(points, np.roll(points, -1, axis=0))] if len(points) > 2 else []
        names = {"rect": ("x", "y", "width", "height"), "circle": ("cx", "cy", "r")}
        numbers = [self._number(element, n) for n in names.get(tag, ("cx", "cy", "rx", "ry"))]
        if min(numbers[2:]) <= 0:
            return []
        if tag == "rect":
            x, y, width, height = numbers
            rx, ry = self._number(element, "rx"), self._number(element, "ry")
            rx, ry = (rx or ry, ry or rx)
            return [_rounded(x, y, width, height, min(rx, width / 2), min(ry, height / 2))]
        x, y, rx = numbers[:3]
        ry = numbers[-1]
        return [_rounded(x - rx, y - ry, 2 * rx, 2 * ry, rx, ry)]

    def _number(self, element: ElementTree.Element, name: str) -> float:
        text = element.get(name, "0").strip().removesuffix("px")
        if not re.fullmatch(_NUMBER, text):
            self._refuse(f"it has {name}={text!r}", "use plain numbers, without units")
        return float(text)

    def _refuse(self, cause: str, remedy: str) -> NoReturn:
        raise InputError("path", str(self._path), cause, remedy) from None


_SHAPES = ("path", "rect", "circle", "ellipse", "polygon", "polyline")
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def _tag(element: ElementTree.Element) -> str:
    return str(element.tag).rpartition("}")[2]


def _declarations(text: str) -> dict[str, str]:
    pairs = (item.split(":", 1) for item in text.split(";") if ":" in item)
    return {key.strip(): value.replace("!important", "").strip() for key, value in pairs}


def _class_rules(root: ElementTree.Element) -> dict[str, dict[str, str]]:
    """The rules `.name { ... }` of all style elements; other selectors are passed over."""
    rules: dict[str, dict[str, str]] = {}
    for element in root.iter():
        if _tag(element) == "style":
            text = re.sub(r"/\*.*?\*/", "", element.text or "", flags=re.S)
            for selectors, inside in re.findall(r"([^{}]+)\{([^}]*)\}", text):
                for name in re.findall(r"(?:^|,)\s*\.([\w-]+)\s*(?=,|$)", selectors.strip()):
                    rules.setdefault(name, {}).update(_declarations(inside))
    return rules


def _rounded(x: float, y: float, width: float, height: float, rx: float, ry: float) -> Contour:
    """A rectangle whose corners are quarters of ellipses; without them if a radius is 0."""
    left, right, low, high = x, x + width, y, y + height
    if rx <= 0 or ry <= 0:
        points = np.array([(left, low), (right, low), (right, high), (left, high)])
        return straight(points, np.roll(points, -1, axis=0))
    corners = np.array([(right, low), (right, high), (left, high), (left, low)])
    along = np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)]) * (rx, ry)
    start, end = corners - along, corners + np.roll(along, -1, axis=0)
    quarters = np.stack(
        [start, start + _QUARTER * along, end + _QUARTER * (corners - end), end], axis=1
    )
    sides = straight(end, np.roll(start, -1, axis=0))
    return np.stack([quarters, sides], axis=1).reshape(-1, 4, 2)


def _matrix(a: float, b: float, c: float, d: float, e: float, f: float) -> Matrix:
    return np.array([[a, c, e], [b, d, f], [0.0, 0.0, 1.0]])


def _turned(degrees: float, x: float = 0.0, y: float = 0.0) -> Matrix:
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    about = _matrix(1, 0, 0, 1, x, y)
    back = _matrix(1, 0, 0, 1, -x, -y)
    return about @ _matrix(cosine, sine, -sine, cosine, 0, 0) @ back


_TRANSFORMS = {
    "matrix": _matrix,
    "translate": lambda x, y=0.0: _matrix(1, 0, 0, 1, x, y),
    "scale": lambda x, y=None: _matrix(x, 0, 0, x if y is None else y, 0, 0),
    "rotate": _turned,
    "skewX": lambda degrees: _matrix(1, 0, math.tan(math.radians(degrees)), 1, 0, 0),
    "skewY": lambda degrees: _matrix(1, math.tan(math.radians(degrees)), 0, 1, 0, 0),
}
