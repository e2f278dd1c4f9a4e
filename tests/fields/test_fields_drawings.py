"""Text, SVG drawings and pictures as profiles; every file is made here."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import fields as sdf
from fields import InputError, MissingDependency
from fields.profiles import lettering

pytest.importorskip("fontTools")

DEJAVU = lettering._default_font()


def at(x, y) -> np.ndarray:
    """Points `(..., 3)` of the plane."""
    return np.stack([*np.broadcast_arrays(x, y), np.zeros(np.broadcast(x, y).shape)], axis=-1)


def plane_bounds(field: sdf.Field) -> np.ndarray:
    """The bounds in x and y."""
    return field._body.tags.extent[:, :2]


def grid(field: sdf.Field, count: int = 400) -> np.ndarray:
    """Points all over the bounds of a profile and a little more."""
    low, high = plane_bounds(field)
    margin = 0.1 * (high - low).max()
    axes = [np.linspace(a - margin, b + margin, count) for a, b in zip(low, high, strict=True)]
    return at(*np.meshgrid(*axes))


# --- text ---


@pytest.fixture(scope="module")
def square_font(tmp_path_factory) -> Path:
    """A font of 1000 units: A and V are squares of 600 with advance 700, B is two squares that
    overlap, wound alike. Kerned: AV by -100 as a pair, VA by -50 by classes."""
    from fontTools.fontBuilder import FontBuilder
    from fontTools.pens.ttGlyphPen import TTGlyphPen

    def squares(*corners):
        pen = TTGlyphPen(None)
        for x, y in corners:
            pen.moveTo((x, y))
            for point in ((x, y + 600), (x + 600, y + 600), (x + 600, y)):
                pen.lineTo(point)
            pen.closePath()
        return pen.glyph()

    builder = FontBuilder(1000, isTTF=True)
    names = [".notdef", "A", "V", "B", "space"]
    builder.setupGlyphOrder(names)
    builder.setupCharacterMap({ord("A"): "A", ord("V"): "V", ord("B"): "B", 32: "space"})
    drawn = [squares(), squares((0, 0)), squares((0, 0)), squares((0, 0), (300, 300)), squares()]
    builder.setupGlyf(dict(zip(names, drawn, strict=True)))
    advances = [(500, 0), (700, 0), (700, 0), (1000, 0), (300, 0)]
    builder.setupHorizontalMetrics(dict(zip(names, advances, strict=True)))
    builder.setupHorizontalHeader(ascent=800, descent=-200)
    builder.setupNameTable({"familyName": "Squares"})
    builder.setupOS2()
    builder.setupPost()
    builder.addOpenTypeFeatures(
        "feature kern { pos A V -100; subtable; pos [V B] [A B] -50; } kern;"
    )
    path = tmp_path_factory.mktemp("fonts") / "squares.ttf"
    builder.save(path)
    return path


@pytest.mark.parametrize(
    ("string", "align", "low", "high"),
    [
        ("A", "left", 0.0, 0.6),
        ("AA", "left", 0.0, 1.3),
        ("AV", "left", 0.0, 1.2),
        ("VA", "left", 0.0, 1.25),
        ("A A", "left", 0.0, 1.6),
        ("AA", "right", -1.4, -0.1),
        ("AA", "center", -0.7, 0.6),
        ("AVA", "left", 0.0, 1.85),
    ],
)
def test_glyphs_stand_where_advances_and_kerning_put_them(square_font, string, align, low, high):
    bounds = plane_bounds(sdf.text(string, square_font, align=align))
    if string == "AVB":
        high = 0.6 + 0.65 + 0.9
    np.testing.assert_allclose(
        bounds, [[low, 0], [high, 0.9 if "B" in string else 0.6]], atol=1e-12
    )


def test_size_scales_and_lines_go_down(square_font):
    two = sdf.text("A\nVA", square_font, size=10, align="left")
    np.testing.assert_allclose(plane_bounds(two), [[0, -10], [12.5, 6]], atol=1e-11)
    assert two(at(9, 3)) > 0
    assert two(at(9, -7)) < 0


def test_outlines_that_overlap_are_united(square_font):
    field = sdf.text("B", square_font, align="left")
    assert field.exact
    assert field(at(0.45, 0.45)) == pytest.approx(-0.15 * 2**0.5, abs=1e-12)  # to (0.6, 0.3)


def test_text_fills_the_pixels_that_pillow_fills():
    """DejaVu Sans, with curves, holes and two parts a glyph, against FreeType.

    Without pairs that are kerned: Pillow's basic layout moves them by 1/64 of what the font says.
    """
    from PIL import Image, ImageDraw, ImageFont

    pixels, string = 240, "o8i&ß"
    font = ImageFont.truetype(str(DEJAVU), pixels, layout_engine=ImageFont.Layout.BASIC)
    picture = Image.new("L", (1300, 400))
    ImageDraw.Draw(picture).text((40, 300), string, fill=255, font=font, anchor="ls")
    drawn = np.asarray(picture) > 127
    row, column = np.mgrid[: drawn.shape[0], : drawn.shape[1]]
    field = sdf.text(string, DEJAVU, size=pixels, align="left", tolerance=0.1)
    values = field(at(column + 0.5 - 40, 300 - row - 0.5))
    # FreeType moves outlines to whole pixels, by up to half of one for each glyph and advance.
    clear = np.abs(values) > 4
    assert clear.mean() > 0.8
    np.testing.assert_array_equal(values[clear] < 0, drawn[clear])
    assert (values < 0).sum() == pytest.approx(drawn.sum(), rel=0.02)


@pytest.mark.parametrize("string", ["AVo", "To", "LT", "HH"])
def test_kerning_is_that_of_freetype(string):
    """As matplotlib asks FreeType for it, without hinting."""
    textpath = pytest.importorskip("matplotlib.textpath")
    properties = pytest.importorskip("matplotlib.font_manager").FontProperties(fname=DEJAVU)
    path = textpath.TextPath((0, 0), string, size=100, prop=properties)
    ours = plane_bounds(sdf.text(string, DEJAVU, size=100, align="left", tolerance=1e-3))
    extents = path.get_extents()
    np.testing.assert_allclose(ours, [extents.min, extents.max], atol=0.5)


def test_the_older_kerning_table_is_read_too(tmp_path):
    from fontTools.ttLib import TTFont

    font = TTFont(DEJAVU)
    expected = sdf.text("AV", DEJAVU, align="left")
    del font["GPOS"]
    font.save(tmp_path / "old.ttf")
    np.testing.assert_allclose(
        plane_bounds(sdf.text("AV", tmp_path / "old.ttf", align="left")), plane_bounds(expected)
    )
    del font["kern"]
    font.save(tmp_path / "none.ttf")
    unkerned = plane_bounds(sdf.text("AV", tmp_path / "none.ttf", align="left"))
    np.testing.assert_allclose(unkerned[1, 0] - plane_bounds(expected)[1, 0], 131 / 2048)


@pytest.mark.parametrize("tolerance", [0.02, 1e-3])
def test_letters_are_exact_distances_with_all_tags(tolerance, rng):
    field = sdf.text("B&", tolerance=tolerance)
    assert field.is_profile
    assert field.exact
    points = at(*rng.uniform(-1, 1, (2, 3_000)))
    values, gradient = field(points), field.gradient(points)
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1, atol=1e-9)
    np.testing.assert_allclose(field(points - values[:, None] * gradient), 0, atol=1e-9)
    fine = sdf.text("B&", tolerance=1e-5)
    assert np.abs(values - fine(points)).max() <= tolerance + 1e-5


def test_text_is_written_and_read_back(square_font):
    for field in (
        sdf.text("AV", square_font),
        sdf.text("it's\n'ß'", size=2, align="left"),
        sdf.text("AV", font=square_font, tolerance=0.1).extrude(0.5),
    ):
        copy = sdf.parse(repr(field), allow_files=True)
        assert repr(copy) == repr(field)
        assert copy.expression is field.expression
        with pytest.raises(InputError, match="reading files is not permitted"):
            sdf.parse(repr(field))


@pytest.mark.parametrize(
    ("make", "argument", "cause"),
    [
        (lambda p: sdf.text(""), "string", "nothing to draw"),
        (lambda p: sdf.text(" \n "), "string", "nothing to draw"),
        (lambda p: sdf.text(7), "string", "not a string"),
        (lambda p: sdf.text("a", size=0), "size", "greater than zero"),
        (lambda p: sdf.text("a", align="top"), "align", "no such alignment"),
        (lambda p: sdf.text("a", tolerance=-1), "tolerance", "greater than zero"),
        (lambda p: sdf.text("a\U0001f9ff"), "string", r"no glyph for it \(U\+1F9FF\)"),
        (lambda p: sdf.text("a\tb"), "string", r"U\+0009"),
        (lambda p: sdf.text("a", p / "none.ttf"), "font", "no such file"),
        (lambda p: sdf.text("a", p), "font", "no such file"),
        (lambda p: sdf.text("a", p / "bad.ttf"), "font", "cannot be read as a font"),
        (lambda p: sdf.text("a", p / "cut.ttf"), "font", "cannot be read as a font"),
    ],
)
def test_text_that_cannot_be_set_is_refused(make, argument, cause, tmp_path):
    (tmp_path / "bad.ttf").write_bytes(b"no font" * 100)
    (tmp_path / "cut.ttf").write_bytes(DEJAVU.read_bytes()[:3_000])
    with pytest.raises(InputError, match=cause) as caught:
        make(tmp_path)
    assert caught.value.argument == argument
    assert caught.value.remedy


def test_missing_libraries_are_named(monkeypatch):
    monkeypatch.setattr(lettering, "find_spec", lambda name: None)
    with pytest.raises(MissingDependency, match="pip install matplotlib"):
        sdf.text("a")
    monkeypatch.setitem(sys.modules, "fontTools.ttLib", None)
    with pytest.raises(MissingDependency, match="pip install fonttools"):
        sdf.text("a", DEJAVU)


# --- SVG ---


@pytest.fixture
def drawn(tmp_path):
    """A function from the inside of an svg element to its profile."""

    def make(inside: str, **options: object) -> sdf.Field:
        path = tmp_path / "drawing.svg"
        path.write_text(
            '<?xml version="1.0"?><svg xmlns="http://www.w3.org/2000/svg" '
            f'xmlns:xlink="http://www.w3.org/1999/xlink" viewBox="0 0 99 99">{inside}</svg>'
        )
        return sdf.svg(path, **options)

    return make


@pytest.mark.parametrize(
    ("inside", "expected"),
    [
        ('<rect x="3" y="4" width="6" height="2"/>', sdf.rectangle((6, 2))),
        ('<rect width="6" height="4" rx="1"/>', sdf.rounded_rectangle((6, 4), 1)),
        ('<rect width="6" height="4" ry="9"/>', sdf.ellipse((3, 2))),
        ('<circle cx="50" cy="20" r="3"/>', sdf.circle(3)),
        ('<ellipse rx="3" ry="1"/>', sdf.ellipse((3, 1))),
        ('<polygon points="0,2 4 2 2,-2"/>', sdf.triangle(4, 4)),
        ('<polyline points="0,2 4 2 2,-2"/>', sdf.triangle(4, 4)),
        ('<path d="M0 2h4l-2-4z"/>', sdf.triangle(4, 4)),
        ('<path d="M 0 2 L 4 2 L 2 -2"/>', sdf.triangle(4, 4)),  # filled as if closed
        ('<path d="M-3 0 A3 3 0 0 0 3 0 A3 3 0 0 0 -3 0z"/>', sdf.circle(3)),
        ('<path d="M0 0h6v4h-6z M1 1h4v2h-4z"/>', sdf.rectangle((6, 4))),  # nonzero
        (
            '<path fill-rule="evenodd" d="M0 0h6v4h-6z M1 1h4v2h-4z"/>',
            sdf.rectangle((6, 4)) - sdf.rectangle((4, 2)),
        ),
        (
            '<path d="M0 0h6v4h-6z M1 1v2h4v-2z"/>',  # the other way round: a hole
            sdf.rectangle((6, 4)) - sdf.rectangle((4, 2)),
        ),
        (
            '<g style="fill-rule:evenodd"><path d="M0 0h6v4h-6z M1 1h4v2h-4z"/></g>',
            sdf.rectangle((6, 4)) - sdf.rectangle((4, 2)),
        ),
        (
            '<rect width="6" height="2"/><rect x="2" y="-2" width="2" height="6"/>',
            sdf.cross(6, 2),
        ),
        ('<rect transform="scale(2 3)" width="3" height="1"/>', sdf.rectangle((6, 3))),
        ('<g transform="rotate(90)"><rect width="6" height="2"/></g>', sdf.rectangle((2, 6))),
        (
            '<g transform="translate(5,5) rotate(30 1 2)"><rect transform="rotate(-30)" '
            'width="6" height="2"/></g>',
            sdf.rectangle((6, 2)),
        ),
        (
            '<rect transform="matrix(1 0 .5 1 9 9)" width="6" height="2"/>',
            sdf.parallelogram(6, 2, -1),  # y downwards in the file
        ),
        ('<rect transform="skewX(45)" width="6" height="2"/>', sdf.parallelogram(6, 2, -2)),
        (
            '<defs><rect id="a" width="2" height="2"/></defs><use href="#a"/>'
            '<use xlink:href="#a" x="1" transform="translate(1 0)"/>',
            sdf.rectangle((4, 2)),
        ),
        (
            '<symbol id="s"><rect width="2" height="2"/></symbol><use href="#s"/>',
            sdf.rectangle(2),
        ),
        (
            '<style>.a{fill:none} .b, .c {display:none}</style><rect width="9" height="9" '
            'class="a"/><rect width="9" height="1" class="c x"/><rect width="2" height="2"/>',
            sdf.rectangle(2),
        ),
        (
            '<rect width="9" height="9" fill="none"/><rect width="9" height="9" '
            'style="display: none"/><g visibility="hidden"><rect width="9" height="9"/></g>'
            '<text visibility="hidden">x</text><rect width="2" height="2" fill="white"/>',
            sdf.rectangle(2),
        ),
        ('<rect width="0" height="9"/><circle r="2px"/>', sdf.circle(2)),
    ],
)  # fmt: skip
def test_a_drawing_is_the_shape_it_shows(drawn, inside, expected):
    field = drawn(inside, tolerance=1e-4)
    assert field.exact
    np.testing.assert_allclose(plane_bounds(field), plane_bounds(expected), atol=1e-3)
    points = grid(field, 60)
    # An arc is drawn by cubic segments, which are off by 2.7e-4 of its radius, here up to 3;
    # values of the difference are compared where they are distances: outside of both.
    values, known = field(points), expected(points)
    np.testing.assert_array_equal(values[np.abs(known) > 1e-3] < 0, known[np.abs(known) > 1e-3] < 0)
    if expected.exact:
        np.testing.assert_allclose(values, known, atol=1e-3)


def test_width_scales_a_drawing_and_tolerance_is_in_the_result(drawn):
    wide = drawn('<circle r="3"/>', width=100, tolerance=0.5)
    np.testing.assert_allclose(plane_bounds(wide), [[-50, -50], [50, 50]], atol=0.5)
    edge = wide(at(50 * np.cos(np.linspace(0, 7, 500)), 50 * np.sin(np.linspace(0, 7, 500))))
    assert 0.1 < edge.max() <= 0.5 + 3e-4 * 50
    copy = sdf.parse(repr(wide), allow_files=True)
    assert copy.expression is wide.expression


@pytest.mark.parametrize(
    ("inside", "cause"),
    [
        ("", "encloses nothing"),
        ('<path d="M0 0 L 5 5"/>', "encloses nothing"),
        ('<rect width="5" height="5" fill="none" stroke="black"/>', "encloses nothing"),
        ("<text>abc</text>", "has a <text> element"),
        ('<g clip-path="url(#c)"><rect width="5" height="5"/></g>', "uses clip-path"),
        ('<rect style="mask:url(#m)" width="5" height="5"/>', "uses mask"),
        ('<svg viewBox="0 0 1 1"><rect width="1" height="1"/></svg>', "view of its own"),
        ('<symbol id="s" viewBox="0 0 1 1"/><use href="#s"/>', "view of its own"),
        ('<use href="#nothing"/>', "uses '#nothing', which is not in it"),
        ('<use href="other.svg#a"/>', "which is not in it"),
        ('<g id="a"><use href="#a"/></g>', "nested too deeply"),
        ('<rect width="5mm" height="5"/>', "width='5mm'"),
        ('<rect width="5" height="5" transform="twist(3)"/>', "has the transform"),
        ('<rect width="5" height="5" transform="matrix(1 2)"/>', "has the transform"),
        ('<path d="M0 0 L 5 x"/>', "path data that cannot be read"),
        ('<path d="L"/>', "path data that cannot be read"),
        ("<rect", "not readable as XML"),
    ],
)
def test_drawings_that_cannot_be_read_are_refused(drawn, inside, cause):
    with pytest.raises(InputError, match=cause) as caught:
        drawn(inside)
    assert caught.value.argument == "path"
    assert caught.value.remedy


def test_what_is_no_drawing_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        sdf.svg(tmp_path / "none.svg")
    (tmp_path / "page.html").write_text("<html></html>")
    with pytest.raises(InputError, match="its root is <html>"):
        sdf.svg(tmp_path / "page.html")


# --- pictures ---


def test_a_picture_of_a_disc_is_a_disc(rng):
    """Anti-aliased: the border is found to a tenth of a pixel."""
    row, column = np.mgrid[:80, :100] + 0.5
    x, y = column - 50, 40 - row
    field = sdf.image((20 - np.hypot(x - 10, y - 5) + 0.5).clip(0, 1), width=100)
    assert field.exact
    assert field.is_profile
    points = at(*rng.uniform(-50, 50, (2, 2_000)))
    expected = np.hypot(points[:, 0] - 10, points[:, 1] - 5) - 20
    np.testing.assert_allclose(field(points), expected, atol=0.1)


def test_a_picture_is_the_distance_to_its_border_by_brute_force(rng):
    """Random pixels: against the crossings of all pixel pairs, which the border passes through."""
    pixels = rng.uniform(0, 1, (12, 15))
    field = sdf.image(pixels, threshold=0.4, width=15)
    row, column = np.mgrid[:12, :15]
    centers = at(column + 0.5 - 7.5, 6 - row - 0.5)
    values = field(centers)
    np.testing.assert_array_equal(values < 0, pixels > 0.4)
    for axis, step in ((1, (1, 0)), (0, (0, -1))):
        first, second = np.delete(pixels, -1, axis), np.delete(pixels, 0, axis)
        t = (first - 0.4) / (first - second)
        crosses = (first > 0.4) != (second > 0.4)
        at_border = np.delete(centers, -1, axis)[crosses]
        at_border[:, :2] += t[crosses][:, None] * step
        np.testing.assert_allclose(field(at_border), 0, atol=1e-12)


def test_values_on_the_threshold_leave_no_slits():
    pixels = np.ones((9, 9))
    pixels[4, 2:7] = 0.5  # a line exactly on the level, which counts as outside
    field = sdf.image(pixels, threshold=0.5, width=9)
    above, below = field(at(0, 0.3)), field(at(0, -0.3))
    assert above == pytest.approx(-0.3, abs=1e-5)
    assert below == pytest.approx(-0.3, abs=1e-5)
    assert field(at(0, 0)) > 0


def test_bright_dark_files_and_transparency(tmp_path):
    from PIL import Image

    pixels = np.full((20, 30), 255, dtype=np.uint8)
    pixels[5:15, 5:10] = 0
    Image.fromarray(pixels).save(tmp_path / "ink.png")
    ink = sdf.image(tmp_path / "ink.png", width=30, inside="dark")
    # The corners are cut by half a pixel, the sides are not.
    np.testing.assert_allclose(plane_bounds(ink), [[-10, -5], [-5, 5]], atol=1e-12)
    assert ink(at(-7.5, 0)) == pytest.approx(-2.5)
    paper = sdf.image(tmp_path / "ink.png", width=30)
    assert paper(at(-7.5, 0)) == pytest.approx(2.5)
    np.testing.assert_allclose(plane_bounds(paper), [[-15, -10], [15, 10]], atol=1e-12)
    cut_out = np.zeros((20, 30, 4), dtype=np.uint8)
    cut_out[5:15, 5:10, 3] = 255
    Image.fromarray(cut_out).save(tmp_path / "cut.png")
    again = sdf.image(tmp_path / "cut.png", width=30, inside="dark")
    assert again.expression is ink.expression
    copy = sdf.parse(repr(ink), allow_files=True)
    assert copy.expression is ink.expression
    assert repr(sdf.image(pixels > 0)) == "<image of 30 x 20 pixels>"


@pytest.mark.parametrize(
    ("make", "argument", "cause"),
    [
        (lambda p: sdf.image(np.zeros((4, 4))), "threshold", "nothing of the picture"),
        (lambda p: sdf.image(np.zeros((4, 4, 3))), "source", "rows of numbers"),
        (lambda p: sdf.image(np.zeros((0, 4))), "source", "rows of numbers"),
        (lambda p: sdf.image(np.array([["a"]])), "source", "rows of numbers"),
        (lambda p: sdf.image(np.array([[1, np.nan]])), "source", "NaN"),
        (lambda p: sdf.image(np.eye(3), inside="left"), "inside", "no such side"),
        (lambda p: sdf.image(np.eye(3), width=0), "width", "greater than zero"),
        (lambda p: sdf.image(p / "none.png"), "source", "no such file"),
        (lambda p: sdf.image(p / "bad.png"), "source", "cannot be read as a picture"),
    ],
)
def test_pictures_that_are_none_are_refused(make, argument, cause, tmp_path):
    (tmp_path / "bad.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"0" * 50)
    with pytest.raises(InputError, match=cause) as caught:
        make(tmp_path)
    assert caught.value.argument == argument
    assert caught.value.remedy
