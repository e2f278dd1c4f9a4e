"""Pictures: what is where in them, that they repeat, and what is refused."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
import trimesh
from PIL import Image

from implicit_warp.errors import InputError, MissingDependency
from implicit_warp.render import Camera, Panel, render, render_row, save_png

SIZE = (120, 90)
BLACK = (0.0, 0.0, 0.0)  # a background that no lit surface has
RED, BLUE = (0.9, 0.1, 0.1), (0.1, 0.1, 0.9)


def silhouette(image: np.ndarray) -> np.ndarray:
    """Pixels that show any of the mesh, in a picture on black without ground."""
    return image.max(axis=2) > 0


def picture(mesh, **options):
    """A small picture on black."""
    return render(mesh, **{"size": SIZE, "background": BLACK, "ground": False, **options})


def apparent_radius(camera: Camera, radius: float, height: int) -> float:
    """The radius in pixels of a ball's outline, in the middle of the picture.

    The cone that touches the ball has half-angle asin(radius / distance).
    """
    distance = np.linalg.norm(np.subtract(camera.eye, camera.target))
    focal = height / 2 / math.tan(math.radians(camera.fov) / 2)
    return focal * math.tan(math.asin(radius / distance))


def assert_disc(mask: np.ndarray, radius: float, edge: float) -> None:
    """The number of pixels is that of a disc, from which `edge` (a fraction) may be missing.

    A pixel counts if any of it is covered, and a circle of radius r crosses at most 8 r + 4 cells
    of the grid (two for every row and every column that it spans).
    """
    area = math.pi * radius**2
    crossed = 8 * radius + 4
    assert area * (1 - edge) - crossed <= mask.sum() <= area + crossed


def test_the_outline_of_a_ball_has_the_right_area():
    ball = trimesh.creation.icosphere(subdivisions=4)
    camera = Camera(eye=(2, -5, 3), target=(0, 0, 0))
    size = (400, 300)
    mask = silhouette(picture(ball, size=size, camera=camera))
    radius = apparent_radius(camera, 1.0, size[1])
    # The polyhedron's faces come closer to the centre than its vertices do, by its inradius.
    inradius = np.linalg.norm(ball.triangles_center, axis=1).min()
    assert_disc(mask, radius, 1 - inradius**2)
    # It is where it should be, too: the centre of gravity is the middle.
    rows, columns = np.nonzero(mask)
    assert np.mean(rows + 0.5) == pytest.approx(150, abs=0.5)
    assert np.mean(columns + 0.5) == pytest.approx(200, abs=0.5)


def test_a_mesh_appears_where_the_camera_projects_it(rng):
    camera = Camera(eye=(2, -5, 3), target=(0.2, 0.1, 0.0), fov=40)
    for _ in range(5):
        place = rng.uniform(-1, 1, 3)
        ball = trimesh.creation.icosphere(subdivisions=2, radius=0.15)
        ball.apply_translation(place)
        rows, columns = np.nonzero(silhouette(picture(ball, camera=camera)))
        middle = np.array([columns.mean(), rows.mean()]) + 0.5
        # Half a pixel for the grid, half for the outline's perspective at this distance.
        assert np.abs(middle - camera.project(place, SIZE)).max() < 1


def test_the_default_camera_keeps_the_border_free(rng):
    for _ in range(3):
        mesh = trimesh.creation.box(extents=rng.uniform(0.05, 3, 3))
        mesh.apply_translation(rng.normal(size=3) * 100)
        mask = silhouette(picture(mesh))
        assert mask.any()
        edge = np.ones_like(mask)
        border = math.floor(0.08 * min(SIZE)) - 1
        edge[border:-border, border:-border] = False
        assert not (mask & edge).any()


@pytest.mark.parametrize("supersampling", [1, 2, 3])
def test_a_function_of_points_colours_each_pixel_by_itself(supersampling):
    # One face of two triangles fills the picture's middle: the boundary between the colours is no
    # edge of the mesh.
    mesh = trimesh.creation.box()
    camera = Camera(eye=(0, -4, 0), target=(0, 0, 0))
    split = 0.137

    def color(points):
        return np.where(points[:, :1] < split, RED, BLUE)

    image = picture(mesh, camera=camera, color=color, supersampling=supersampling).astype(int)
    column = camera.project((split, -0.5, 0), SIZE)[0]
    row = image[SIZE[1] // 2]
    left, right = camera.project([(-0.5, -0.5, 0), (0.5, -0.5, 0)], SIZE)[:, 0]
    reddish = row[:, 0] > 2 * row[:, 2]
    bluish = row[:, 2] > 2 * row[:, 0]
    assert reddish[math.ceil(left) : math.floor(column)].all()
    assert bluish[math.ceil(column) : math.floor(right)].all()


def test_a_function_gets_points_on_the_surface_in_the_meshs_own_units():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=5e5)
    center = np.array([3e6, -2e6, 1e6])
    ball.apply_translation(center)
    seen = []

    def color(points):
        seen.append(points)
        return np.full_like(points, 0.5)

    picture(ball, color=color)
    distance = np.linalg.norm(np.concatenate(seen) - center, axis=1)
    inradius = np.linalg.norm(ball.triangles_center - center, axis=1).min()
    # Points lie on the faces up to float32 barycentric weights: 1e-6 of the radius.
    assert distance.max() <= 5e5 * (1 + 1e-6)
    assert distance.min() >= inradius - 5e5 * 1e-6


def test_colours_of_faces_and_of_vertices_land_on_them():
    mesh = trimesh.creation.box()
    camera = Camera(eye=(0, -4, 0), target=(0, 0, 0))
    front = mesh.face_normals[:, 1] < -0.5
    of_faces = picture(mesh, camera=camera, color=np.where(front[:, None], RED, BLUE))
    right = mesh.vertices[:, :1] > 0
    of_vertices = picture(mesh, camera=camera, color=np.where(right, BLUE, RED))
    middle = SIZE[1] // 2
    shown = silhouette(of_faces)[middle]
    assert (of_faces[middle, shown, 0] > of_faces[middle, shown, 2]).all()
    first, last = np.flatnonzero(shown)[[1, -2]]
    assert of_vertices[middle, first, 0] > of_vertices[middle, first, 2]
    assert of_vertices[middle, last, 2] > of_vertices[middle, last, 0]


def test_panels_share_camera_and_scale():
    large = trimesh.creation.icosphere(subdivisions=4)
    small = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    camera = Camera(eye=(0, -6, 0), target=(0, 0, 0))
    row = render_row(
        [Panel(large), Panel(small)], size=(200, 200), camera=camera, background=BLACK, ground=False
    )
    assert row.shape == (200, 400, 3)
    inradius = np.linalg.norm(large.triangles_center, axis=1).min()
    for half, radius in ((row[:, :200], 1.0), (row[:, 200:], 0.5)):
        assert_disc(silhouette(half), apparent_radius(camera, radius, 200), 1 - inradius**2)


def test_without_a_camera_all_panels_fit_the_common_view():
    near = trimesh.creation.box()
    far = near.copy()
    far.apply_translation((4, 0, 0))
    row = render_row([Panel(near), Panel(far)], size=SIZE, background=BLACK, ground=False)
    left, right = silhouette(row[:, : SIZE[0]]), silhouette(row[:, SIZE[0] :])
    # The two boxes are apart in the world, so they are apart in the common view.
    assert left.any()
    assert right.any()
    assert np.nonzero(left)[1].max() < np.nonzero(right)[1].min()


def test_the_same_mesh_gives_the_same_panel_and_the_same_bytes(tmp_path):
    mesh = trimesh.creation.torus(0.6, 0.25)
    row = render_row([Panel(mesh), Panel(mesh)], size=SIZE)
    assert np.array_equal(row[:, : SIZE[0]], row[:, SIZE[0] :])
    assert np.array_equal(row[:, : SIZE[0]], render(mesh, size=SIZE))
    for name in ("a.png", "b.png"):
        save_png(tmp_path / name, render(mesh, size=SIZE))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_bands_of_rows_leave_no_seam(monkeypatch):
    mesh = trimesh.creation.torus(0.6, 0.25)
    whole = render(mesh, size=SIZE)
    monkeypatch.setattr("implicit_warp.render.picture.BAND_SAMPLES", 5 * SIZE[0] * 4)
    in_bands = render(mesh, size=SIZE)
    # The same samples are averaged in windows that start at other rows of the array: only the
    # rounding of float32 differs, and where the filter's two passes meet a band's halo.
    difference = np.abs(whole.astype(int) - in_bands)
    assert difference.max() <= 2
    assert (difference > 0).mean() < 0.02


def test_place_and_size_in_the_world_do_not_matter():
    mesh = trimesh.creation.torus(0.6, 0.25)
    other = mesh.copy()
    other.apply_scale(1024.0)
    other.apply_translation((4096, -8192, 1024))
    difference = np.abs(render(mesh, size=SIZE).astype(int) - render(other, size=SIZE))
    # Rays that graze an edge may fall on its other side after rounding.
    assert (difference > 2).mean() < 0.005


def test_a_mesh_inside_out_is_shown_from_both_sides():
    mesh = trimesh.creation.box()
    inside_out = trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)
    camera = Camera.fit(mesh.bounds, size=SIZE)
    difference = picture(mesh, camera=camera).astype(int) - picture(inside_out, camera=camera)
    assert np.abs(difference).max() <= 2


def test_the_background_runs_from_top_to_bottom_and_shadows_only_darken():
    top, bottom = (0.9, 0.8, 0.7), (0.5, 0.6, 0.7)
    mesh = trimesh.creation.box()
    plain = render(mesh, size=SIZE, background=(top, bottom), ground=False).astype(int)
    assert np.abs(plain[0] - np.multiply(top, 255)).max() <= 1
    assert np.abs(plain[-1] - np.multiply(bottom, 255)).max() <= 1
    shadowed = render(mesh, size=SIZE, background=(top, bottom)).astype(int)
    outside = ~silhouette(picture(mesh))
    darker = plain[outside] - shadowed[outside]
    assert darker.min() >= 0
    assert darker.max() > 20


def test_labels_add_a_strip_and_touch_nothing_else():
    mesh = trimesh.creation.box()
    plain = render_row([Panel(mesh), Panel(mesh)], size=SIZE, background=(1, 1, 1))
    labelled = render_row(
        [Panel(mesh, label="before"), Panel(mesh)], size=SIZE, background=(1, 1, 1)
    )
    assert np.array_equal(labelled[: SIZE[1]], plain)
    strip = labelled[SIZE[1] :]
    assert strip[:, : SIZE[0]].min() < 160
    assert strip[:, SIZE[0] :].min() == 255


def test_a_long_label_is_made_to_fit():
    mesh = trimesh.creation.box()
    row = render_row([Panel(mesh, label="w" * 80), Panel(mesh)], size=SIZE, background=(1, 1, 1))
    assert row[SIZE[1] :, SIZE[0] :].min() == 255
    assert row[SIZE[1] :, : SIZE[0]].min() < 255


def test_a_png_comes_back_as_it_was(tmp_path, rng):
    image = rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)
    save_png(tmp_path / "noise.png", image)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "noise.png")), image)
    assert [path.name for path in tmp_path.iterdir()] == ["noise.png"]


def test_a_failed_save_leaves_the_old_picture_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "picture.png"
    path.write_bytes(b"old")

    def full_disk(*_args, **_options):
        raise OSError("no space left on device")

    monkeypatch.setattr(Image.Image, "save", full_disk)
    with pytest.raises(OSError, match="no space"):
        save_png(path, np.zeros((4, 4, 3), np.uint8))
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["picture.png"]


def broken(**changes) -> trimesh.Trimesh:
    mesh = trimesh.creation.box()
    parts = {"vertices": mesh.vertices.copy(), "faces": mesh.faces.copy(), **changes}
    return trimesh.Trimesh(**parts, process=False)


def with_nan() -> trimesh.Trimesh:
    vertices = trimesh.creation.box().vertices.copy()
    vertices[3, 1] = math.nan
    return broken(vertices=vertices)


BOX = trimesh.creation.box()


@pytest.mark.parametrize(
    ("call", "argument", "message"),
    [
        (lambda: render(trimesh.Trimesh()), "mesh", "no faces"),
        (lambda: render(with_nan()), "mesh", "1 of its 8 vertices are not finite"),
        (lambda: render(broken(faces=[[0, 1, 99]])), "mesh", "names vertex 99"),
        (lambda: render(BOX, color=(0.5, 0.5)), "color", r"\(2,\) fits neither the 8 vertices"),
        (lambda: render(BOX, color=np.zeros((7, 3))), "color", r"\(7, 3\) fits neither"),
        (lambda: render(BOX, color=(255, 0, 0)), "color", "divide values of 0..255 by 255"),
        (lambda: render(BOX, color=(math.nan, 0, 0)), "color", "within"),
        (lambda: render(BOX, color="red"), "color", "not numbers"),
        (lambda: render(BOX, color=lambda p: p[:, 0] * 0), "color", "it gave shape"),
        (lambda: render(BOX, color=lambda p: p * 0 + 7), "color", "within"),
        (lambda: render(BOX, background=(2, 2, 2)), "background", "within"),
        (lambda: render(BOX, background=(1, 1)), "background", "not one colour"),
        (lambda: render(BOX, size=(0, 10)), "size", "16 to 16384"),
        (lambda: render(BOX, size=(100.5, 100)), "size", "16 to 16384"),
        (lambda: render(BOX, size=100), "size", "16 to 16384"),
        (lambda: render(BOX, crease_angle=-1), "crease_angle", "0 to 180"),
        (lambda: render(BOX, supersampling=0), "supersampling", "1 to 8"),
        (lambda: render_row([]), "panels", "nothing to show"),
    ],
)
def test_bad_input_is_refused_by_name_with_the_cause(call, argument, message):
    with pytest.raises(InputError, match=message) as caught:
        call()
    assert caught.value.argument == argument


@pytest.mark.parametrize(
    ("name", "image", "argument"),
    [
        ("picture.jpg", np.zeros((4, 4, 3), np.uint8), "path"),
        ("nowhere/picture.png", np.zeros((4, 4, 3), np.uint8), "path"),
        ("picture.png", np.zeros((4, 4), np.uint8), "image"),
        ("picture.png", np.zeros((4, 4, 3)), "image"),
        ("picture.png", None, "image"),
    ],
)
def test_what_cannot_be_saved_is_refused_by_name(tmp_path, name, image, argument):
    with pytest.raises(InputError) as caught:
        save_png(tmp_path / name, image)
    assert caught.value.argument == argument
    assert list(tmp_path.iterdir()) == []


def test_without_open3d_the_error_names_it_and_the_system_packages(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingDependency, match=r"pip install open3d.*libusb-1\.0-0"):
        render(BOX, size=SIZE)


def test_without_pillow_the_error_names_it(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "PIL.Image", None)
    with pytest.raises(MissingDependency, match="pip install pillow"):
        save_png(tmp_path / "a.png", np.zeros((4, 4, 3), np.uint8))
