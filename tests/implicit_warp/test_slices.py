"""Plane sections: values, contours in closed form, SVG files and pictures."""

from __future__ import annotations

import re
import sys
from xml.etree import ElementTree

import numpy as np
import pytest

import fields as sdf
import implicit_warp as iw
from implicit_warp.cli import main
from implicit_warp.errors import InputError, MissingDependency
from implicit_warp.slices import frame_of, read_plane

BALL = sdf.sphere(1.0, (0.3, -0.2, 0.1))
RING = sdf.torus(1.0, 0.3)
PLANES = [("x", 0.2), ("y", -0.3), ("z", 0.4), ("-z", -0.4), ((1, 2, -2), 0.1), ((0, 1, 1), 0.0)]


def _area(line):
    """Signed, positive if the closed polyline runs counter-clockwise."""
    x, y = line.T
    return 0.5 * float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum())


# --- values and planes ---


@pytest.mark.parametrize("plane", PLANES)
def test_points_are_in_the_plane_and_values_are_the_fields(plane):
    section = iw.slice_values(BALL, plane, 40)
    frame = section.frame
    normal = np.cross(frame.right, frame.up)
    assert abs(normal @ frame.origin) == pytest.approx(abs(plane[1]), abs=1e-12)
    np.testing.assert_allclose((section.points - frame.origin) @ normal, 0, atol=1e-12)
    basis = np.stack([frame.right, frame.up])
    np.testing.assert_allclose(basis @ basis.T, np.eye(2), atol=1e-12)
    np.testing.assert_array_equal(section.values, BALL(section.points))
    steps = np.diff(section.right), np.diff(section.up)
    np.testing.assert_allclose(np.concatenate(steps), steps[0][0])


def test_planes_square_to_an_axis_keep_the_names_and_signs_of_the_others():
    for axis, right, up in (("x", "y", "z"), ("y", "x", "z"), ("z", "x", "y")):
        frame = frame_of((axis, 0.5))
        assert frame.names == (right, up, f"{axis} = 0.5")
        np.testing.assert_array_equal(frame.right, np.eye(3)["xyz".index(right)])
        np.testing.assert_array_equal(frame.up, np.eye(3)["xyz".index(up)])
    assert frame_of(("-z", 0.4)).names[2] == "z = -0.4"


def test_the_whole_shape_is_covered_with_room_around_it():
    for plane in PLANES:
        section = iw.slice_values(RING, plane, 80)
        border = np.concatenate(
            [section.values[[0, -1]].ravel(), section.values[:, [0, -1]].ravel()]
        )
        assert border.min() > 0.05


def test_boxes_can_be_given():
    section = iw.slice_values(sdf.below(0.1), ("x", 0.0), 21, bounds=((-1, -1, -1), (1, 1, 1)))
    assert section.values.shape == (21, 21)
    np.testing.assert_allclose(section.up[[0, -1]], (-1, 1))
    np.testing.assert_allclose(section.values[:, 0], section.up - 0.1)


@pytest.mark.parametrize(
    ("text", "plane"),
    [("z=0.5", ("z", 0.5)), ("x", ("x", 0.0)), ("-y=1", ("-y", 1.0)),
     ("1,1,0=0.2", ((1.0, 1.0, 0.0), 0.2)), ("z=-1e-2", ("z", -0.01))],
)  # fmt: skip
def test_planes_are_read(text, plane):
    assert read_plane(text) == plane


@pytest.mark.parametrize(
    "text", ["", "w=1", "z=up", "1,2=0", "0,0,0=1", "z=1=2", "z=nan", "1,a,2=0"]
)
def test_other_texts_are_no_planes(text):
    with pytest.raises(InputError):
        read_plane(text)


# --- contours ---


@pytest.mark.parametrize("plane", PLANES)
def test_a_ball_is_cut_in_a_circle(plane):
    (line,) = iw.contours(BALL, plane, resolution=200)
    normal = np.array(frame_of(plane).origin) if plane[1] else np.array([0, 1, 1]) / np.sqrt(2)
    normal = normal / np.linalg.norm(normal)
    center = np.array([0.3, -0.2, 0.1])
    # Interpolation along an edge of step h leaves at most h^2 / 8 times the curvature.
    error = np.abs(np.linalg.norm(line - center, axis=1) - 1)
    height = normal @ center - abs(plane[1])
    radius = np.sqrt(1 - height**2)
    step = 2.4 / 199 * 1.7
    assert error.max() < step**2 / radius
    np.testing.assert_array_equal(line[0], line[-1])


@pytest.mark.parametrize("level", [0.0, -0.1, 0.15])
def test_contours_run_counter_clockwise_around_the_inside(level):
    lines = iw.slice_values(RING, ("z", 0.0), 200).contours(level)
    areas = sorted(_area(line) for line in lines)
    inner, outer = 0.7 - level, 1.3 + level
    np.testing.assert_allclose(areas, [-np.pi * inner**2, np.pi * outer**2], rtol=1e-3)


def test_contours_converge_at_second_order():
    errors = []
    for resolution in (25, 49, 97):
        (line,) = iw.contours(BALL, ("z", 0.1), resolution=resolution)
        errors.append(np.abs(np.linalg.norm(line - [0.3, -0.2, 0.1], axis=1) - 1).max())
    assert (np.log2(np.array(errors[:-1]) / errors[1:]) > 1.6).all()


def test_contours_that_leave_the_picture_are_open():
    box = ((-1, -1, -1), (1, 1, 1))
    (line,) = iw.contours(sdf.below(0.1), ("x", 0.0), resolution=21, bounds=box)
    np.testing.assert_allclose(sorted(line[[0, -1], 1]), [-1, 1])
    np.testing.assert_allclose(line[:, 2], 0.1)
    assert iw.contours(sdf.below(5), ("x", 0.0), bounds=box) == []


# --- SVG ---


def test_svg_holds_the_contours_in_true_size(tmp_path):
    path = tmp_path / "ring.svg"
    section = iw.slice_values(RING, ("z", 0.0), 120)
    iw.save_contours(path, section, (0.0, -0.1), units="cm")
    root = ElementTree.parse(path).getroot()
    assert root.get("width").endswith("cm")
    width, height = np.ptp(section.right), np.ptp(section.up)
    assert float(root.get("width")[:-2]) == pytest.approx(width, rel=1e-8)
    np.testing.assert_allclose(
        [float(x) for x in root.get("viewBox").split()], [0, 0, width, height]
    )
    paths = root.findall(".//{*}path")
    assert [p.get("id") for p in paths] == ["level 0", "level -0.1"]
    pieces = re.findall(r"M([^MZ]*)Z", paths[0].get("d"))
    assert len(pieces) == 2
    lines = [
        np.array([[float(x) for x in pair.split(",")] for pair in piece.split()])
        for piece in pieces
    ]
    radii = sorted(np.linalg.norm(line - [width / 2, height / 2], axis=1).mean() for line in lines)
    np.testing.assert_allclose(radii, [0.7, 1.3], rtol=1e-3)


def test_svg_shows_up_as_up(tmp_path):
    path = tmp_path / "a.svg"
    high = sdf.sphere(0.2, (0, 0, 0.7))
    iw.save_contours(path, iw.slice_values(high, ("y", 0), 60, bounds=((-1,) * 3, (1,) * 3)))
    numbers = re.findall(
        r"[-\d.e]+,([-\d.e]+)", ElementTree.parse(path).find(".//{*}path").get("d")
    )
    assert np.mean([float(n) for n in numbers]) == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize(
    ("name", "options", "cause"),
    [("a.svg", {"levels": (5.0,)}, "none is met"), ("a.svg", {"units": "furlong"}, "not a length"),
     ("a.dxf", {}, "cannot write"), ("no/a.svg", {}, "does not exist"),
     ("a.svg", {"levels": (np.nan,)}, "finite")],
)  # fmt: skip
def test_svg_that_cannot_be_written_is_named(name, options, cause, tmp_path):
    with pytest.raises(InputError, match=cause):
        iw.save_contours(tmp_path / name, iw.slice_values(RING, resolution=20), **options)
    assert list(tmp_path.iterdir()) == []


# --- pictures ---


def _pixels(path):
    image = pytest.importorskip("PIL.Image", reason="looks at pictures")
    return np.asarray(image.open(path).convert("RGB")).astype(int)


def test_a_picture_is_blue_inside_and_warm_outside(tmp_path):
    pytest.importorskip("matplotlib", reason="draws the pictures")
    path = tmp_path / "ball.png"
    figure = iw.slice_plot(sdf.sphere(1.0), path=path, resolution=100)
    pixels = _pixels(path)
    red, blue = pixels[..., 0], pixels[..., 2]
    assert 0.1 < (blue > red + 20).mean() < 0.6
    assert (red > blue + 20).mean() > 0.1
    assert (pixels.max(axis=-1) < 60).mean() > 0.002  # the surface's line
    assert figure.axes[0].get_title() == "z = 0"
    assert "distance" in figure.axes[-1].get_ylabel()
    assert figure.axes[0].get_aspect() == 1


def test_panels_share_scale_and_colours(tmp_path):
    pytest.importorskip("matplotlib", reason="draws the pictures")
    bar = sdf.box((0.5, 0.5, 2.0))
    handles = [iw.hold(sdf.below(-0.8), name="foot"), iw.move(sdf.above(0.8), rotate=("y", 90))]
    turned = iw.deform(bar, iw.Affine(*_turn()))
    figure = iw.slice_plot(
        [bar, turned],
        ("y", 0.0),
        tmp_path / "two.png",
        titles=["rest", "turned"],
        handles=handles,
        resolution=80,
        units="mm",
    )
    first, second, colours = figure.axes
    assert (first.get_xlim(), first.get_ylim()) == (second.get_xlim(), second.get_ylim())
    assert first.images[0].norm is second.images[0].norm
    assert first.get_title() == "rest (y = 0)"
    assert first.get_xlabel() == "x (mm)"
    assert colours.get_ylabel() == "value (mm)"
    texts = [text.get_text() for text in first.get_legend().get_texts()]
    assert texts == ["foot: held", "above(0.8): moved"]
    assert (tmp_path / "two.png").stat().st_size > 10_000


def _turn():
    return np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.zeros(3)


def test_lines_are_at_equal_spacing():
    pytest.importorskip("matplotlib", reason="draws the pictures")

    def levels(**options):
        ax = iw.slice_plot(sdf.sphere(1.0), resolution=60, **options).axes[0]
        return sorted(level for drawn in ax.collections for level in drawn.levels)

    np.testing.assert_allclose(np.diff(levels(spacing=0.25)), 0.25)
    np.testing.assert_allclose(levels(levels=(-0.5, 0.1)), (-0.5, 0, 0.1))
    chosen = np.diff(levels())
    np.testing.assert_allclose(chosen, chosen[0])
    assert 6 < len(chosen) < 20


@pytest.mark.parametrize(
    ("options", "cause"),
    [
        ({"titles": ["a", "b"]}, "1 fields"),
        ({"spacing": 0.0}, "values here lie between"),
        ({"spacing": -1.0}, "values here lie between"),
        ({"spacing": 1e-9}, "values here lie between"),
        ({"levels": (np.inf,)}, "not finite"),
        ({"path": "section.gif"}, "cannot write"),
        ({"path": "no/such/folder.png"}, "does not exist"),
        ({"plane": ("w", 0)}, "no such axis"),
        ({"plane": "z=0"}, "not a normal and an offset"),
        ({"plane": ("z", np.nan)}, "finite"),
        ({"resolution": 2}, "too few samples"),
        ({"bounds": ((0, 0, 0),)}, "two rows"),
    ],
)
def test_bad_arguments_are_named(options, cause):
    pytest.importorskip("matplotlib", reason="draws the pictures")
    with pytest.raises(InputError, match=cause):
        iw.slice_plot(sdf.sphere(1.0), **options)


def test_fields_that_cannot_be_cut_are_named():
    with pytest.raises(InputError, match="unbounded"):
        iw.slice_values(sdf.below(0))
    with pytest.raises(InputError, match="not a field"):
        iw.slice_values(3)
    broken = sdf.from_function(lambda p: p[..., 0].log(), bounds=((-1,) * 3, (1,) * 3), name="log")
    with pytest.raises(InputError, match="NaN or infinite, the first at"):
        iw.slice_values(broken)


def test_a_missing_matplotlib_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingDependency, match=r"implicit_warp\[plot\]"):
        iw.slice_plot(sdf.sphere(1.0))


# --- the command ---

SCRIPT = "import fields as sdf\nshape = sdf.box((1.0, 1.0, 3.0)) - sdf.cylinder(0.25)\n"

HANDLES = """
[[handle]]
name = "foot"
region = "below(-1.2)"
hold = true

[[handle]]
region = "above(1.2)"
rotate = ["z", 45]
"""


@pytest.fixture
def part(tmp_path):
    (tmp_path / "part.py").write_text(SCRIPT)
    (tmp_path / "part.toml").write_text(HANDLES)
    iw.save(iw.Twist(90, between=(-1.5, 1.5)), tmp_path / "warp.safetensors")
    return tmp_path


def test_the_command_draws(part, capsys):
    pytest.importorskip("matplotlib", reason="draws the pictures")
    arguments = ["slice", f"{part}/part.py", "-o", f"{part}/s.png", "--plane", "y=0.1"]
    arguments += ["--warp", f"{part}/warp.safetensors", "--handles", f"{part}/part.toml"]
    assert main([*arguments, "--resolution", "60", "--levels", "-0.1", "0.2"]) == 0
    assert _pixels(part / "s.png").shape[1] > 1.2 * _pixels(part / "s.png").shape[0]
    assert "y=0.1" in capsys.readouterr().out


def test_the_command_writes_contours(part):
    arguments = ["slice", f"{part}/part.py", "-o", f"{part}/s.svg", "--resolution", "60"]
    assert main(arguments) == 0
    before = ElementTree.parse(part / "s.svg").find(".//{*}path").get("d")
    assert before.count("Z") == 2
    assert main([*arguments, "--plane", "z=1", "--warp", f"{part}/warp.safetensors"]) == 0
    assert ElementTree.parse(part / "s.svg").find(".//{*}path").get("d") != before


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["-o", "s.gif"], "cannot write"),
        (["-o", "s.svg", "--plane", "q=1"], "no such axis"),
        (["-o", "s.svg", "--spacing", "0.1"], "for pictures"),
        (["-o", "s.svg", "--plane", "z=9"], "none is met"),
    ],
)
def test_the_command_refuses(options, complaint, part, monkeypatch, capsys):
    monkeypatch.chdir(part)
    assert main(["slice", "part.py", *options]) == 2
    assert complaint in capsys.readouterr().err


def test_the_command_takes_a_volume(tmp_path):
    sdf.save_grid(RING, tmp_path / "ring.npz", spacing=0.05)
    assert main(["slice", f"{tmp_path}/ring.npz", "-o", f"{tmp_path}/s.svg"]) == 0
    drawn = ElementTree.parse(tmp_path / "s.svg").find(".//{*}path").get("d")
    assert drawn.count("Z") == 2
