"""Solids of profiles: volumes, shapes, tags, and what is refused."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

import fields as sdf
from fields import InputError
from fields.tags import grown
from implicit_warp.extraction import extract
from tests.fields.catalogue.profiles import FLOWER, L_SHAPE

PLUS = sdf.rectangle((1.6, 0.4)) | sdf.rectangle((0.4, 1.6))
WEDGE = [(0.5, -0.6), (1.2, -0.3), (0.7, 0.6)]


def area_and_centroid(corners) -> tuple[float, float]:
    """The area of a polygon and the x of its centroid."""
    x, y = np.array(corners, dtype=float).T
    cross = x * np.roll(y, -1) - y * np.roll(x, -1)
    area = cross.sum() / 2
    return area, ((x + np.roll(x, -1)) * cross).sum() / (6 * area)


WEDGE_AREA, WEDGE_X = area_and_centroid(WEDGE)


def sampled_volume(field: sdf.Field, rng: np.random.Generator, count: int = 96) -> float:
    """The part of its box that is inside, by one random point in each of 96^3 cells."""
    low, high = field.bounds
    cells = np.stack(np.meshgrid(*[np.arange(count)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = low + (cells + rng.uniform(0, 1, cells.shape)) * (high - low) / count
    return float((field(points) < 0).mean() * np.prod(high - low))


@pytest.mark.parametrize(
    ("solid", "volume"),
    [
        (sdf.polygon(L_SHAPE).extrude(1.2), 1.2 * area_and_centroid(L_SHAPE)[0]),
        (sdf.polygon(FLOWER).extrude(1.2), 1.2 * area_and_centroid(FLOWER)[0]),
        (PLUS.extrude(1.2), 1.2 * (2 * 1.6 * 0.4 - 0.16)),
        (sdf.polygon(L_SHAPE).twist_extrude(1.2, 70), 1.2 * area_and_centroid(L_SHAPE)[0]),
        (PLUS.twist_extrude(1.2, 70), 1.2 * (2 * 1.6 * 0.4 - 0.16)),
        # The mean of the squared scale of 1 to t is (1 + t + t^2) / 3.
        (sdf.rectangle(2).taper_extrude(1.5, 0.5), 4 * 1.5 * (1 + 0.5 + 0.25) / 3),
        (PLUS.twist_extrude(1.5, 70, top=2), 1.5 * (2 * 1.6 * 0.4 - 0.16) * 7 / 3),
        # The means of two concentric circles' distances are those of the circles between.
        (sdf.circle(1).extrude_to(sdf.circle(0.4), 2), 2 * np.pi * (1 + 0.4 + 0.16) / 3),
        (
            sdf.circle(1).loft(sdf.circle(0.4), sdf.circle(0.8), heights=(-1, 0, 2)),
            np.pi / 3 * ((1 + 0.4 + 0.16) + 2 * (0.16 + 0.32 + 0.64)),
        ),
        # Pappus: the area times the way of its centroid.
        (sdf.circle(0.3).revolve(0.8), np.pi * 0.09 * 2 * np.pi * 0.8),
        (sdf.polygon(WEDGE).revolve(), WEDGE_AREA * 2 * np.pi * WEDGE_X),
        (sdf.polygon(WEDGE).revolve(0.3), WEDGE_AREA * 2 * np.pi * (WEDGE_X + 0.3)),
        (sdf.polygon(WEDGE).revolve(degrees=130), WEDGE_AREA * np.radians(130) * WEDGE_X),
        (sdf.polygon(WEDGE).revolve(degrees=280), WEDGE_AREA * np.radians(280) * WEDGE_X),
        (sdf.rectangle((1.6, 1.1)).revolve(), np.pi * 0.64 * 1.1),
        (sdf.rectangle((1.6, 1.1)).revolve(degrees=90), np.pi * 0.64 * 1.1 / 4),
        (sdf.polygon([(0, -0.8), (0.9, -0.5), (0, 0.8)]).revolve(), np.pi * 0.81 * 1.6 / 3),
        # Over whole turns every half-plane has the section once a turn.
        (sdf.rectangle((0.4, 0.2)).coil(0.9, 0.5, 3), 0.08 * 2 * np.pi * 0.9 * 3),
        (sdf.polygon(WEDGE).coil(0.2, -1.5, 2), WEDGE_AREA * 2 * np.pi * (WEDGE_X + 0.2) * 2),
        # A mitred sweep of a shape centred on the path has the volume of the straight one.
        (
            sdf.rectangle((0.5, 0.3)).sweep(
                [(0, 0, 0), (1.5, 0, 0), (1.5, 1.5, 0), (1.5, 1.5, 1.5)]
            ),
            0.15 * 4.5,
        ),
        (sdf.circle(0.2).sweep([(0, 0, 0), (0, 1, 1), (0, 2, 1)]), np.pi * 0.04 * (1 + 2**0.5)),
        (sdf.lathe([(0.5, -1), (1, 0), (0.5, 1)]), 2 * np.pi / 3 * (1 + 0.5 + 0.25)),
    ],
    ids=lambda value: repr(value)[:60] if isinstance(value, sdf.Field) else "",
)
def test_volumes_are_those_of_the_formulas(solid, volume, rng):
    # Only cells on the surface are left to chance: some 6 * 96^2 of them, half a cell each with
    # a standard deviation of sqrt(6 * 96^2) / 2 = 118 cells, of 20,000 and more that are inside.
    assert sampled_volume(solid, rng) == pytest.approx(volume, rel=0.01)


def test_an_extrusion_is_the_solid_of_the_same_name(rng):
    points = rng.uniform(-2, 2, (2_000, 3))
    for profile, solid in (
        (sdf.rectangle((1, 2)).extrude(0.5), sdf.box((1, 2, 0.5))),
        (sdf.circle(0.7).extrude(1.5), sdf.cylinder(0.7, 1.5)),
        (sdf.circle(0.3).revolve(1), sdf.torus(1, 0.3)),
        (sdf.circle(0.9).revolve(), sdf.sphere(0.9)),
        (sdf.rectangle((1.4, 1.5)).revolve(), sdf.cylinder(0.7, 1.5)),
        (sdf.triangle(1.6, 1.6).revolve(), sdf.cone(0.8, 1.6)),
        (sdf.circle(0.4).sweep([(0, 0, -1), (0, 0, 1)]), sdf.cylinder(0.4, 2)),
    ):
        assert profile.exact
        np.testing.assert_allclose(profile(points), solid(points), atol=1e-14)
        np.testing.assert_allclose(profile.bounds, solid.bounds, atol=1e-15)


def test_the_ends_of_a_loft_are_its_profiles_and_twists_turn_them(rng):
    points = rng.uniform(-1.5, 1.5, (2_000, 3))
    base, top = sdf.rectangle((1.6, 0.6)), sdf.star(5, 1, 0.4)
    solid = base.extrude_to(top, 2)
    twisted = base.twist_extrude(2, 90, top=0.5)
    for height, profile in ((-1, base), (1, top)):
        at = points * (1, 1, 0) + (0, 0, height * (1 - 1e-12))
        np.testing.assert_array_equal(solid(at) < 0, profile(at) < 0)
    for height, profile in ((-1, base.rotate(-45)), (1, base.scale(0.5).rotate(45))):
        at = points * (1, 1, 0) + (0, 0, height * (1 - 1e-12))
        np.testing.assert_array_equal(twisted(at) < 0, profile(at) < 0)


def test_smooth_easing_leaves_profiles_without_a_crease():
    parts = (sdf.circle(1), sdf.circle(0.5))
    slopes = {
        ease: parts[0].extrude_to(parts[1], 2, ease).gradient((1.001, 0, -1 + 1e-6))[2]
        for ease in ("linear", "smooth")
    }
    assert slopes["linear"] == pytest.approx(0.25)
    assert abs(slopes["smooth"]) < 1e-5


# --- tags ---


@pytest.mark.parametrize("degrees_a_unit", [0, 90, 360])
def test_the_bound_of_a_twist_is_reached_and_not_passed(degrees_a_unit, rng):
    """sqrt(1 + k^2 rho^2); with a plate of 2 x 0.2 and k = 2 pi it is 6.39."""
    plate = sdf.rectangle((2, 0.2)).twist_extrude(4, 4 * degrees_a_unit)
    expected = math.hypot(1, np.radians(degrees_a_unit) * math.hypot(1, 0.1))
    assert plate.lipschitz == pytest.approx(expected, rel=1e-14)
    points = rng.uniform((-1.2, -1.2, -1.9), (1.2, 1.2, 1.9), (100_000, 3))
    steepest = np.linalg.norm(plate.gradient(points), axis=1).max()
    assert 0.97 * expected < steepest <= expected + 1e-12
    far = rng.uniform(-50, 50, (10_000, 3))  # the bound holds everywhere
    assert np.linalg.norm(plate.gradient(far), axis=1).max() <= expected + 1e-12


@pytest.mark.parametrize(
    "solid",
    [
        PLUS.twist_extrude(2, 300),
        PLUS.taper_extrude(2, 3),
        PLUS.twist_extrude(2, 300, top=0.2),
        PLUS.translate((0.5, 0.2, 0)).extrude_to(sdf.circle(0.1), 0.7),
        sdf.rectangle(1).taper_extrude(0.5, 3),
        sdf.star(7, 1, 0.3).extrude_to(sdf.circle(0.1), 0.2, "smooth"),
        sdf.rectangle((0.4, 0.2)).sweep([(0, 0, 0), (2, 0, 0), (1, 1.5, 0), (0, 0, 1)]),
        sdf.circle(0.2).coil(0.5, 2, 3),
    ],
    ids=repr,
)
def test_bounds_on_slope_and_growth_hold_far_away(solid, rng):
    """The laws of the catalogue look within 4 of the origin; these look within 100."""
    for size in (1, 10, 100):
        points = rng.uniform(-size, size, (20_000, 3))
        norm = np.linalg.norm(solid.gradient(points), axis=1)
        assert norm.max() <= solid.lipschitz + 1e-11
        other = points + rng.normal(size=points.shape) * 10 ** rng.uniform(-2, 1, (20_000, 1))
        change = np.abs(solid(points) - solid(other))
        assert (change <= solid.lipschitz * np.linalg.norm(points - other, axis=1) + 1e-11).all()
        tags = solid._body.tags
        for level in (0.1, 1.0, 10.0):
            within = points[solid(points) <= level]
            extent = grown(tags.extent, tags.growth * level + 1e-11)
            assert ((within >= extent[0]) & (within <= extent[1])).all()


def test_the_bound_of_a_loft_is_close(rng):
    """It is the true largest difference and what it may rise between 129 samples a side."""
    solid = sdf.circle(1).extrude_to(sdf.circle(0.4), 1)
    assert math.hypot(1, 0.6) <= solid.lipschitz < math.hypot(1, 0.63)


def test_what_is_not_known_of_a_profile_is_not_known_of_its_solid():
    box = ((-0.5, -0.4, -1), (0.5, 0.4, 1))
    known = sdf.sphere(0.4).remap(lambda p: p, lipschitz=2, bounds=box).slice(0)
    steep = sdf.sphere(0.4).remap(lambda p: p, bounds=box, growth=3).slice(0)
    circle, path = sdf.circle(0.2), [(0, 0, 0), (0, 0, 4), (0, 4, 4)]
    for profile, lipschitz, growths in (
        # A confined field has growth 1 about its disc, whatever it was; other solids need its own.
        (known, True, (None, 1.0, 1.0, None, None)),
        (steep, False, (3.0, 3 * math.sqrt(2), 3.0, 3.0, 5 * math.sqrt(2))),
    ):
        solids = (
            profile.extrude(1),
            profile.twist_extrude(1, 90),
            profile.taper_extrude(1, 0.5),
            profile.extrude_to(circle, 1),
            profile.sweep(path),
        )
        for solid, growth in zip(solids, growths, strict=True):
            assert (solid.lipschitz is not None) is lipschitz
            assert solid.bounds is not None
            assert solid._body.tags.growth == (growth and pytest.approx(growth))
    np.testing.assert_allclose(known.taper_extrude(1, 0.5).bounds[1, 0], math.hypot(0.5, 0.4))
    np.testing.assert_allclose(steep.taper_extrude(1, 0.5).bounds[1, 0], 0.5)


@pytest.mark.parametrize(
    ("solid", "exact"),
    [
        (sdf.circle(1).extrude(1), True),
        (PLUS.extrude(1), False),
        (sdf.circle(1).twist_extrude(1, 10), False),
        (sdf.circle(1).taper_extrude(1, 0.5), False),
        (sdf.circle(1).extrude_to(sdf.circle(1), 1), False),
        (sdf.polygon(WEDGE).revolve(), True),
        (sdf.polygon(WEDGE).revolve(degrees=90), True),
        (sdf.polygon(WEDGE).revolve(-0.5), False),  # touches the axis in a corner
        (sdf.polygon(WEDGE).revolve(-0.7), False),
        (sdf.ellipse((1, 0.5)).revolve(), True),
        (sdf.ellipse((1, 0.5)).revolve(0.1), False),
        (sdf.ellipse((1, 0.5)).revolve(degrees=90), False),
        (sdf.polygon([(-1, 0), (1, 0), (0, 1)]).revolve(), False),  # mirrored, but not by formula
        (sdf.box(1).slice(0), False),
        (sdf.circle(1).slice(5), True),
        (sdf.circle(0.1).sweep([(0, 0, 0), (1, 0, 0)]), True),
        (sdf.circle(0.1).sweep([(0, 0, 0), (1, 0, 0), (2, 1, 0)]), False),
    ],
    ids=lambda value: repr(value) if isinstance(value, sdf.Field) else "",
)
def test_the_exact_tag(solid, exact):
    assert solid.exact is exact


@pytest.mark.parametrize(
    ("solid", "bounds"),
    [
        (sdf.rectangle((2, 1)).extrude(3), [[-1, -0.5, -1.5], [1, 0.5, 1.5]]),
        (sdf.rectangle((2, 1)).taper_extrude(3, 2), [[-2, -1, -1.5], [2, 1, 1.5]]),
        (sdf.rectangle((6, 8)).twist_extrude(3, 9), [[-5, -5, -1.5], [5, 5, 1.5]]),
        (sdf.circle(1).loft(sdf.circle(2), heights=(3, 7)), [[-2, -2, 3], [2, 2, 7]]),
        (sdf.circle(1).revolve(2), [[-3, -3, -1], [3, 3, 1]]),
        (sdf.circle(1).revolve(2, 90), [[0, 0, -1], [3, 3, 1]]),
        (sdf.circle(1).revolve(2, 180), [[-3, 0, -1], [3, 3, 1]]),
        (sdf.circle(1).revolve(2, 60), [[0.5, 0, -1], [3, 3 * 0.75**0.5, 1]]),
        (sdf.circle(1).revolve(0, 90), [[0, 0, -1], [1, 1, 1]]),
        (sdf.circle(1).coil(3, 2, 5), [[-4, -4, -5], [4, 4, 5]]),
        (sdf.circle(1).sweep([(0, 0, 0), (0, 0, 9)]), [[-1, -1, 0], [1, 1, 9]]),
        (sdf.circle(1).sweep([(0, 0, 0), (0, 0, 9), (0, 9, 9)]), [[-1, -1, 0], [1, 9, 10]]),
        (sdf.strip(1).extrude(1), None),
        (sdf.sphere(1).slice(0), None),
    ],
    ids=lambda value: repr(value) if isinstance(value, sdf.Field) else "",
)
def test_the_bounds_tag(solid, bounds):
    if bounds is None:
        assert solid.bounds is None
    else:
        np.testing.assert_allclose(solid.bounds, bounds, atol=1e-14)


def test_a_slice_is_what_the_plane_cuts(rng):
    solid = (sdf.sphere(1) - sdf.box(0.9)).rotate(20, (1, 2, 3))
    points = rng.uniform(-1, 1, (2_000, 3))
    cut = solid.slice(0.3)
    np.testing.assert_array_equal(cut(points), solid(points * (1, 1, 0) + (0, 0, 0.3)))
    assert cut.extrude(0.5).bounds is not None
    np.testing.assert_allclose(cut._body.tags.extent[:, :2], solid.bounds[:, :2])


def test_no_surface_is_left_on_the_axis_or_at_joints(rng):
    """Inside a solid no value is zero: on the axis of a lathe work, in the plane of a joint."""
    cone = sdf.polygon([(0, -0.8), (0.9, -0.5), (0, 0.8)]).revolve()
    axis = np.column_stack([np.zeros((200, 2)), np.linspace(-0.7, 0.7, 200)])
    assert (cone(axis) < 0).all()
    bent = sdf.rectangle((0.5, 0.3)).sweep([(0, 0, 0), (2, 0, 0), (2, 2, 0), (2, 2, 2)])
    path = np.array([(0, 0, 0), (2, 0, 0), (2, 2, 0), (2, 2, 2)], dtype=float)
    along = np.concatenate([np.linspace(a, b, 101) for a, b in pairwise(path)])
    ends = np.linalg.norm(along[:, None] - path[[0, -1]], axis=-1).min(axis=1)
    np.testing.assert_allclose(bent(along), -np.minimum(0.15, ends), atol=1e-15)


def test_a_sweep_keeps_the_profile_through_joints(rng):
    """Half-way along every segment the section is the profile, turned as the frames say."""
    path = np.array([(0, 0, 0), (0, 0, 3), (3, 0, 3), (3, 3, 3)], dtype=float)
    profile = sdf.triangle(0.8, 0.5)
    swept = profile.sweep(path)
    frames = [
        ((1, 0, 0), (0, 1, 0)),  # along z
        ((0, 0, -1), (0, 1, 0)),  # turned about y
        ((0, 0, -1), (-1, 0, 0)),  # turned about z
    ]
    u, v = rng.uniform(-0.6, 0.6, (2, 500, 1))
    for i, (x, y) in enumerate(frames):
        middle = (path[i] + path[i + 1]) / 2
        at = middle + u * np.array(x) + v * np.array(y)
        section = profile(np.column_stack([u, v, np.zeros(500)]))
        np.testing.assert_allclose(swept(at), section, atol=1e-14)


def test_coils_are_handed(rng):
    """A quarter of a turn on, a right-handed coil is a quarter of its pitch higher."""
    for pitch in (1.0, -1.0):
        spring = sdf.circle(0.2).coil(1, pitch, 4)
        angle = rng.uniform(-np.pi, np.pi, 500)
        height = pitch * angle / (2 * np.pi)
        on_path = np.stack([np.cos(angle), np.sin(angle), height], axis=1)
        np.testing.assert_allclose(spring(on_path), -0.2, atol=1e-12)


# --- meshes ---


def test_a_twisted_plate_has_no_holes_and_its_volume():
    """2 x 0.2 x 1 at one turn a unit, where fields that pass for distances get holes.

    Pruned by the Lipschitz bound, and again without a bound: the same mesh. Marching cubes bevels
    edges, with an error of second order in the voxel; the volume extrapolated from two is 0.4.
    """
    plate = sdf.rectangle((2, 0.2)).twist_extrude(1, 360)
    unpruned = sdf.Field(plate.expression, bounds=plate.bounds)
    volumes = []
    for resolution in (96, 144):
        mesh = extract(plate, resolution)
        assert mesh.is_watertight
        assert mesh.euler_number == 2
        volumes.append(mesh.volume)
        if resolution == 96:
            np.testing.assert_array_equal(extract(unpruned, resolution).vertices, mesh.vertices)
    ratio = (144 / 96) ** 2
    limit = (ratio * volumes[1] - volumes[0]) / (ratio - 1)
    assert limit == pytest.approx(0.4, rel=0.003)


@pytest.mark.slow
def test_a_twisted_plate_at_full_length():
    """The plate of 2 x 0.2 x 4, true volume 1.6, at 448 voxels along it."""
    mesh = extract(sdf.rectangle((2, 0.2)).twist_extrude(4, 4 * 360), 448)
    assert mesh.is_watertight
    assert mesh.euler_number == 2
    assert mesh.volume == pytest.approx(1.6, rel=0.004)


# --- errors ---


@pytest.mark.parametrize(
    ("make", "argument", "cause"),
    [
        (lambda: sdf.sphere(1).extrude(1), "field", "not a profile"),
        (lambda: sdf.sphere(1).revolve(), "field", "not a profile"),
        (lambda: sdf.box(1).sweep([(0, 0, 0), (0, 0, 1)]), "field", "not a profile"),
        (lambda: sdf.circle(1).loft(sdf.box(1), heights=(0, 1)), "field", "not a profile"),
        (lambda: sdf.circle(1).extrude(0), "height", "greater than zero"),
        (lambda: sdf.strip(1).twist_extrude(1, 90), "field", "no bounds in x and y"),
        (lambda: sdf.circle(1).negate().taper_extrude(1, 2), "field", "no bounds in x and y"),
        (lambda: sdf.left(1).extrude_to(sdf.circle(1), 1), "field", "no bounds in x and y"),
        (lambda: sdf.circle(1).taper_extrude(1, 0), "top", "greater than zero"),
        (lambda: sdf.circle(1).twist_extrude(1, np.inf), "degrees", "finite"),
        (lambda: sdf.circle(1).loft(heights=(0,)), "heights", "1 heights for 1 profiles"),
        (lambda: sdf.circle(1).loft(sdf.circle(2), heights=(0, 1, 2)), "heights", "3 heights"),
        (lambda: sdf.circle(1).loft(sdf.circle(2), heights=(1, 0)), "heights", "do not rise"),
        (lambda: sdf.circle(1).extrude_to(sdf.circle(2), 1, "quick"), "ease", "no such easing"),
        (lambda: sdf.circle(1).extrude_to(3, 1), "field", "takes fields"),
        (lambda: sdf.circle(1).revolve(-1), "offset", "far side of the axis"),
        (lambda: sdf.circle(1).revolve(2, 0), "degrees", "not within a turn"),
        (lambda: sdf.circle(1).revolve(2, 361), "degrees", "not within a turn"),
        (lambda: sdf.circle(1).coil(2, 0.9, 3), "pitch", "reaches 1 up or down"),
        (lambda: sdf.circle(1).coil(1, 3, 3), "radius", "reaches the axis"),
        (lambda: sdf.circle(1).coil(2, 3, 0), "turns", "greater than zero"),
        (lambda: sdf.circle(1).remap(abs, lipschitz=1).coil(2, 3, 1), "field", "not a profile"),
        (
            lambda: sdf.sphere(1).remap(abs, bounds=[[-1] * 3, [1] * 3]).slice(0).coil(2, 3, 1),
            "field",
            "nothing is known of its values",
        ),
        (lambda: sdf.circle(1).sweep([(0, 0, 0)]), "points", "two or more"),
        (lambda: sdf.circle(1).sweep([(0, 0, 0), (1, 0)]), "points", "two or more"),
        (lambda: sdf.circle(1).sweep([(0, 0, 0), (0, 0, 0)]), "points", "are equal"),
        (lambda: sdf.circle(1).sweep([(0, 0, 0), (9, 0, 0), (0, 1, 0)]), "points", "turns back"),
        (lambda: sdf.circle(1).sweep([(0, 0, 0), (1, 0, 0), (1, 1, 0)]), "points", "segment 0"),
        (lambda: sdf.sphere(1).slice("top"), "z", "real number"),
    ],
)
def test_bad_arguments_are_named(make, argument, cause):
    with pytest.raises(InputError, match=cause) as caught:
        make()
    assert caught.value.argument == argument
    assert caught.value.remedy
