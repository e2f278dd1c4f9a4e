"""Handles, their files, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import fields as sdf
import implicit_warp as iw
from implicit_warp.affine import rotation_matrix
from implicit_warp.errors import InputError
from implicit_warp.handles import load_handles, save_handles
from implicit_warp.sampling import sample_shape


def test_motion_turns_about_the_pivot_and_then_shifts():
    handle = iw.move(sdf.above(0), rotate=("z", 90), pivot=(1, 0, 0), translate=(0, 0, 5))
    np.testing.assert_allclose(
        handle.motion(np.array([2.0, 0.0, 1.0])), (1.0, 1.0, 6.0), atol=1e-15
    )


def test_rotation_about_any_axis_is_right_handed_and_keeps_it():
    axis = np.array([1.0, 2.0, -2.0])
    turn = rotation_matrix(axis, 30.0)
    np.testing.assert_allclose(turn @ axis, axis, atol=1e-15)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
    across = np.cross(axis, (0.0, 0.0, 1.0))
    assert np.dot(np.cross(across, turn @ across), axis) > 0
    np.testing.assert_allclose(np.trace(turn), 1.0 + 2.0 * np.cos(np.radians(30.0)))


def test_matrix_and_words_give_the_same_motion():
    words = iw.move(sdf.above(0), rotate=("y", 40), translate=(1, 2, 3))
    matrix = iw.move(sdf.above(0), matrix=words.motion.matrix.tolist())
    x = np.random.default_rng(0).normal(size=(5, 3))
    np.testing.assert_allclose(words.motion(x), matrix.motion(x), rtol=0, atol=1e-15)


def test_files_and_api_are_the_same_thing(tmp_path):
    handles = [
        iw.hold(sdf.below(-0.6), name="foot"),
        iw.move(sdf.above(0.6) & sdf.sphere(2.0), rotate=("z", 60), pivot=(0, 1, 0), weight=2.5),
        iw.move(sdf.left(-5), translate=(0.1, 0, 1 / 3), name='say "hi"'),
        iw.move(sdf.right(5), matrix=np.eye(3, 4)),
    ]
    path = tmp_path / "handles.toml"
    save_handles(path, handles, {"steps": 30, "frames": "triplane", "tolerance": 1e-4})
    again, solve = load_handles(path)
    assert solve == {"steps": 30, "frames": "triplane", "tolerance": 1e-4}
    x = np.random.default_rng(0).normal(size=(200, 3))
    for before, after in zip(handles, again, strict=True):
        assert (before.name, before.weight, before.is_held) == (
            after.name,
            after.weight,
            after.is_held,
        )
        np.testing.assert_array_equal(before.motion(x), after.motion(x))
        np.testing.assert_array_equal(before.region(x), after.region(x))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["no [[handle]] table"]),
        ("[[handle", ["not a TOML file"]),
        ("[[handel]]\nregion='above(1)'", ["unknown table 'handel'", "[[handle]]"]),
        ("[[handle]]\nhold=true", ["needs a region", "handle 1"]),
        ("[[handle]]\nregion='above(1)'", ["neither", "hold = true"]),
        ("[[handle]]\nregion='above(1)'\nhold=true\ntranslate=[0,0,1]", ["held and moved"]),
        ("[[handle]]\nregion='above(1)'\nturn=['z',3]", ["turn", "rotate"]),
        ("[[handle]]\nregion='above(1)'\nrotate=['w',3]", ["axis = 'w'", '"x", "y", "z"']),
        ("[[handle]]\nregion='above(1)'\nrotate=['z']", ["not a pair of axis and angle"]),
        ("[[handle]]\nregion='above(1)'\ntranslate=[0,1]", ["translate", "(3,)"]),
        ("[[handle]]\nregion='above(1)'\ntranslate=[0,1,nan]", ["translate", "not finite"]),
        ("[[handle]]\nregion='open(1)'\nhold=true", ["open", "h.toml, handle 1"]),
        ("[[handle]]\nregion='above(1)'\nhold='false'", ["neither true nor false"]),
        ("[[handle]]\nregion='above(1)'\nhold=true\nname=3", ["name = 3"]),
        ("handle=[1,2]", ["no [[handle]] table"]),
        ("solve=3\n[[handle]]\nregion='above(1)'\nhold=true", ["solve = 3"]),
        ("[[handle]]\nregion='above(1)'\nhold=true\nweight=-1", ["weight = -1"]),
    ],
)
def test_bad_handle_files_are_explained(tmp_path, text, words):
    path = tmp_path / "h.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_handles(path)
    for word in words:
        assert word in str(caught.value)


def test_missing_handle_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.toml.*cannot be read"):
        load_handles(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: iw.move(sdf.above(0)), "there is no motion"),
        (lambda: iw.move(sdf.above(0), pivot=(0, 0, 1)), "there is no motion"),
        (lambda: iw.hold("top"), "not a field"),
        (lambda: iw.move(sdf.above(0), matrix=np.diag([2.0, 1.0, 0.5, 1.0])), "not a rotation"),
        (lambda: iw.move(sdf.above(0), matrix=np.eye(4), rotate=("z", 1)), "the whole motion"),
        (lambda: iw.Affine(np.diag([1.0, 1.0, -1.0])), "mirrors space"),
        (lambda: iw.Affine(np.eye(2)), "pass shape (3, 3)"),
    ],
)
def test_bad_motions_are_named(make, words):
    with pytest.raises(InputError) as caught:
        make()
    assert words in str(caught.value)


BALL = sdf.sphere(1.0)


def test_samples_lie_where_they_should_and_repeat():
    handles = [iw.hold(sdf.below(-0.5)), iw.move(sdf.above(0.9), rotate=("z", 9))]
    samples = sample_shape(BALL, handles, 5000, 300, seed=4)
    assert samples.interior.shape == (5000, 3)
    assert (BALL(samples.interior) <= 0).all()
    for handle, points in zip(handles, samples.regions, strict=True):
        assert len(points) == 300
        assert (handle.region(points) <= 0).all()
        assert (BALL(points) <= 0).all()
    # Uniform: a ball of half the radius holds an eighth of the points; four standard deviations.
    share = (samples.interior.norm(dim=1) < 0.5).double().mean()
    assert abs(share - 0.125) < 4.0 * (0.125 * 0.875 / 5000) ** 0.5
    again = sample_shape(BALL, handles, 5000, 300, seed=4)
    assert (again.interior == samples.interior).all()


def test_a_tiny_region_is_still_found():
    tiny = iw.hold(sdf.sphere(0.02, center=(0.5, 0.0, 0.0)))
    assert len(sample_shape(BALL, [tiny], 100, 50, seed=0).regions[0]) > 0


@pytest.mark.parametrize(
    ("shape", "handles", "words"),
    [
        (sdf.below(0), [iw.hold(sdf.above(-1))], "intersect it with a box"),
        (BALL, [iw.hold(sdf.above(2), name="hat")], "'hat': this handle selects nothing"),
        (BALL & sdf.sphere(1.0, center=(1.999, 0, 0)) & sdf.above(0.5), [], "none of"),
        (
            BALL,
            [
                iw.hold(sdf.below(0.1), name="a"),
                iw.move(sdf.above(-0.1), rotate=("z", 9), name="b"),
            ],
            "['a', 'b']: these two contradict each other",
        ),
    ],
)
def test_impossible_handles_are_explained(shape, handles, words):
    with pytest.raises(InputError) as caught:
        sample_shape(shape, handles, 100, 100, seed=0)
    assert words in str(caught.value)


def test_contradictions_are_found_in_either_order_and_however_small():
    large = iw.hold(sdf.below(1.0), name="large")
    small = iw.move(sdf.sphere(0.08, center=(0, 0, -0.9)), translate=(0, 0, 0.5), name="small")
    for handles in ([large, small], [small, large]):
        with pytest.raises(InputError, match="contradict each other"):
            sample_shape(BALL, handles, 100, 128, seed=0)


def test_overlapping_handles_that_agree_are_fine():
    turn = {"rotate": ("z", 20)}
    handles = [iw.move(sdf.above(0.1), **turn), iw.move(sdf.above(0.3), **turn)]
    assert len(sample_shape(BALL, handles, 100, 100, seed=0).regions) == 2
