"""Bodies and pairs: small models of every kind, the cache, and the loaders on files made here."""

from __future__ import annotations

import pickle
import sys
import types

import numpy as np
import pytest
from scipy.sparse import csc_matrix
from scipy.spatial.transform import Rotation

import implicit_warp as iw
from experiments.bodies import AmassPoses, AnnyBody, FigureBody, SmplBody, pairs, sound_pairs
from experiments.bodies.skinning import joint_transforms, skin
from implicit_warp.errors import FileFormatError, InputError, MissingDependency


@pytest.fixture(scope="module")
def figure() -> FigureBody:
    return FigureBody(resolution=40)


def test_pairs_are_sound_seeded_and_cached(figure, tmp_path):
    first = list(pairs(2, 5, figure, tmp_path))
    assert len({pair.name for pair in first}) == 2
    for pair in first:
        for mesh in (pair.source, pair.target):
            iw.check(mesh).raise_if_bad()
        assert np.array_equal(pair.source.faces, pair.target.faces)
        assert np.abs(pair.source.vertices - pair.target.vertices).max() > 0.1
        assert 1.3 < pair.height < 2.2
    assert len(list(tmp_path.iterdir())) == 2

    class Unused:
        name, faces = figure.name, figure.faces

    again = list(pairs(2, 5, Unused(), tmp_path))
    assert [p.height for p in again] == [p.height for p in first]
    assert all(
        np.array_equal(a.source.vertices, b.source.vertices)
        for a, b in zip(again, first, strict=True)
    )
    fresh = next(pairs(1, 5, figure, tmp_path / "elsewhere"))
    assert np.array_equal(fresh.target.vertices, first[0].target.vertices)
    other = next(pairs(1, 6, figure, tmp_path))
    assert not np.array_equal(other.target.vertices, first[0].target.vertices)


def test_a_body_that_is_never_sound_is_named(figure, tmp_path, monkeypatch):
    class Folded(FigureBody):
        def vertices(self, shape, pose):
            turned = super().vertices(shape, pose)
            # The head goes through the chest.
            return turned - (turned[:, 2:] > 1.4) * [0.0, 0.0, 0.5]

    monkeypatch.setattr(sound_pairs, "_TRIES", 10)
    with pytest.raises(InputError, match="no sound body in 10 tries"):
        next(pairs(1, 0, Folded(resolution=24), tmp_path))


def test_the_figure_is_one_closed_solid_and_bends(figure):
    shape, rest = np.ones(3), np.zeros((11, 3))
    mesh = figure.vertices(shape, rest)
    assert np.allclose(skin(mesh, np.ones((len(mesh), 1)), np.eye(3, 4)[None]), mesh)
    bent = rest.copy()
    bent[figure._names.index("shin.L")] = [np.pi / 3, 0.0, 0.0]
    moved = np.linalg.norm(figure.vertices(shape, bent) - mesh, axis=1)
    foot = (mesh[:, 2] < 0.2) & (mesh[:, 0] > 0)
    assert moved[foot].min() > 0.2
    assert moved[mesh[:, 2] > 1.0].max() < 1e-3


def test_fitting_a_figure(figure, tmp_path):
    pair = next(pairs(1, 5, figure, tmp_path))
    warp = iw.fit(pair.source, pair.target, height=pair.height, steps=150, progress=False)
    report = warp.report
    assert report.vertex_error < report.history[0][3] / 30
    assert report.gradient_error < report.history[0][4] / 8
    assert iw.certify(warp).proved


def test_a_chain_of_joints_moves_rigidly():
    """Against the product of homogeneous matrices, joint by joint."""
    rng = np.random.default_rng(2)
    parents = np.array([-1, 0, 1, 0])
    joints, vectors = rng.normal(size=(4, 3)), rng.normal(size=(4, 3))

    def local(j: int) -> np.ndarray:
        there, back, turn = np.eye(4), np.eye(4), np.eye(4)
        there[:3, 3], back[:3, 3] = joints[j], -joints[j]
        turn[:3, :3] = Rotation.from_rotvec(vectors[j]).as_matrix()
        return there @ turn @ back

    expected = [local(0), local(0) @ local(1), local(0) @ local(1) @ local(2), local(0) @ local(3)]
    found = joint_transforms(parents, joints, vectors)
    assert np.allclose(found, np.array(expected)[:, :3], atol=1e-12)


def smpl_arrays(seed: int = 0, vertices: int = 40) -> dict[str, np.ndarray]:
    """Arrays of the shapes that SMPL's files have, random but with a closed surface."""
    from implicit_warp.benchmark.workloads import sphere_mesh

    rng = np.random.default_rng(seed)
    points, faces = sphere_mesh(vertices)
    weights = rng.random((vertices, 24)) ** 8
    regressor = rng.random((24, vertices)) ** 8
    return {
        "v_template": points * [0.3, 0.9, 0.2],
        "shapedirs": 0.01 * rng.normal(size=(vertices, 3, 300)),
        "posedirs": 0.01 * rng.normal(size=(vertices, 3, 207)),
        "J_regressor": regressor / regressor.sum(1, keepdims=True),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": np.array(
            [[2**32 - 1, *(max(0, (j - 1) // 2) for j in range(1, 24))], range(24)]
        ),
        "f": faces.astype(np.uint32),
    }


def test_smpl_is_read_from_npz_and_follows_its_formula(tmp_path):
    arrays = smpl_arrays()
    np.savez(tmp_path / "SMPL_NEUTRAL.npz", **arrays)
    body = SmplBody(tmp_path / "SMPL_NEUTRAL.npz", lambda rng: 0.2 * rng.normal(size=(22, 3)))
    rng = np.random.default_rng(1)
    shape, pose = body.sample_shape(rng), body.sample_pose(rng)
    assert shape.shape == (10,)
    assert pose.shape == (24, 3)
    assert not pose[22:].any()

    # One vertex, written out.
    v, betas = 7, np.concatenate([shape, np.zeros(290)])
    shaped = arrays["v_template"] + np.einsum("vik,k->vi", arrays["shapedirs"], betas)
    joints = arrays["J_regressor"] @ shaped
    turns = [Rotation.from_rotvec(p).as_matrix() for p in pose]
    posed = shaped[v].copy()
    for j in range(1, 24):
        posed += arrays["posedirs"][v, :, 9 * (j - 1) : 9 * j] @ (turns[j] - np.eye(3)).ravel()
    image = np.zeros(3)
    for j in range(24):
        x, k = posed.copy(), j
        while True:
            x = turns[k] @ (x - joints[k]) + joints[k]
            if k == 0:
                break
            k = arrays["kintree_table"][0, k]
        image += arrays["weights"][v, j] * x
    assert np.allclose(body.vertices(shape, pose)[v], image, atol=1e-12)
    assert body.height(np.zeros(10)) == pytest.approx(np.ptp(arrays["v_template"][:, 1]))


def test_smpl_agrees_with_smplx(tmp_path):
    smplx, torch = pytest.importorskip("smplx"), pytest.importorskip("torch")
    arrays = smpl_arrays(vertices=6890)
    np.savez(tmp_path / "SMPL_NEUTRAL.npz", **arrays)
    (tmp_path / "SMPL_NEUTRAL.pkl").write_bytes(pickle.dumps(arrays))
    body = SmplBody(tmp_path / "SMPL_NEUTRAL.npz", lambda rng: 0.3 * rng.normal(size=(24, 3)))
    rng = np.random.default_rng(1)
    shape, pose = body.sample_shape(rng), body.sample_pose(rng)
    theirs = smplx.SMPL(str(tmp_path / "SMPL_NEUTRAL.pkl"), dtype=torch.float64)(
        betas=torch.from_numpy(shape)[None],
        global_orient=torch.from_numpy(pose[:1]).reshape(1, 3),
        body_pose=torch.from_numpy(pose[1:]).reshape(1, 69),
    )
    # Their Rodrigues formula adds 1e-8 to every angle.
    found = theirs.vertices[0].detach().numpy()
    assert np.allclose(body.vertices(shape, pose), found, atol=1e-6)


def old_pickle(arrays: dict[str, np.ndarray], monkeypatch) -> bytes:
    """As the official files are: a chumpy array and a sparse matrix among the others."""
    chumpy = types.ModuleType("chumpy.ch")
    chumpy.Ch = type("Ch", (), {"__module__": "chumpy.ch"})
    shapes = chumpy.Ch()
    shapes.x = arrays["shapedirs"]
    content = {**arrays, "shapedirs": shapes, "J_regressor": csc_matrix(arrays["J_regressor"])}
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "chumpy", types.ModuleType("chumpy"))
        patch.setitem(sys.modules, "chumpy.ch", chumpy)
        return pickle.dumps(content, protocol=2)


def test_smpl_is_read_from_its_pickles_without_running_them(tmp_path, monkeypatch):
    arrays = smpl_arrays()
    path = tmp_path / "basicModel.pkl"
    path.write_bytes(old_pickle(arrays, monkeypatch))
    np.savez(tmp_path / "same.npz", **arrays)
    rest, shape = np.zeros((24, 3)), np.arange(10.0)
    one, other = (SmplBody(p, lambda rng: rest) for p in (path, tmp_path / "same.npz"))
    assert np.array_equal(one.vertices(shape, rest), other.vertices(shape, rest))

    class Evil:
        def __reduce__(self):
            return (exec, ("raise SystemExit('it ran')",))

    path.write_bytes(pickle.dumps({**arrays, "extra": Evil()}))
    with pytest.raises(FileFormatError, match=r"builtins.exec, which is no array"):
        SmplBody(path, lambda rng: rest)


def test_bad_smpl_files_are_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        SmplBody(tmp_path / "SMPL.npz", lambda rng: None)
    (tmp_path / "SMPL.obj").touch()
    with pytest.raises(InputError, match=r"neither \.npz nor \.pkl"):
        SmplBody(tmp_path / "SMPL.obj", lambda rng: None)
    arrays = smpl_arrays()
    del arrays["posedirs"]
    np.savez(tmp_path / "SMPL.npz", **arrays)
    with pytest.raises(FileFormatError, match="posedirs"):
        SmplBody(tmp_path / "SMPL.npz", lambda rng: None)
    (tmp_path / "SMPL.pkl").write_bytes(b"\x80\x04")
    with pytest.raises(FileFormatError, match="not a readable SMPL model"):
        SmplBody(tmp_path / "SMPL.pkl", lambda rng: None)


def test_amass_poses_are_drawn_from_the_files(tmp_path):
    rng = np.random.default_rng(0)
    (tmp_path / "CMU" / "01").mkdir(parents=True)
    poses = rng.normal([0.5] * 78 + [0.0] * 78, [0.2] * 156, size=(400, 156))
    np.savez(tmp_path / "CMU" / "01" / "01_poses.npz", poses=poses, betas=np.zeros(16))
    np.savez(tmp_path / "CMU" / "01" / "shape.npz", betas=np.zeros(16))
    amass = AmassPoses(tmp_path, every=4)
    assert amass.frames.shape == (100, 66)
    assert (amass.frame(rng).ravel() == amass.frames).all(1).any()
    drawn = np.array([amass.gaussian(rng).ravel() for _ in range(400)])
    # Means and spreads of 400 x 66 draws: within five standard errors.
    assert drawn.mean() == pytest.approx(amass.frames.mean(), abs=5 * 0.3 / np.sqrt(400 * 66))
    ratio = drawn.std(0).mean() / amass.frames.std(0).mean()
    assert ratio == pytest.approx(1.5, rel=5 / np.sqrt(2 * 400 * 66))


@pytest.mark.parametrize(
    ("poses", "message"),
    [(np.zeros((5, 60)), "are not AMASS's"), (np.full((5, 156), np.nan), "are not AMASS's")],
)
def test_bad_amass_files_are_named(poses, message, tmp_path):
    with pytest.raises(InputError, match=r"no \.npz file with poses"):
        AmassPoses(tmp_path)
    np.savez(tmp_path / "a_poses.npz", poses=poses)
    with pytest.raises(FileFormatError, match=message):
        AmassPoses(tmp_path)
    (tmp_path / "a_poses.npz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(FileFormatError, match="not a readable"):
        AmassPoses(tmp_path)


def test_anny_without_its_extra_names_the_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "anny", None)
    with pytest.raises(MissingDependency, match=r"implicit_warp\[human\]"):
        AnnyBody()


@pytest.mark.slow
def test_anny_bodies_are_sound_and_keep_to_their_distributions(tmp_path):
    pytest.importorskip("anny")
    body = AnnyBody()
    assert len(body.faces) == 26_692
    pair = next(pairs(1, 0, body, tmp_path))
    report = iw.check(pair.source)
    assert report.ok
    assert len(report.vertices) == 13_348
    assert 1.0 < pair.height < 2.6
    rng = np.random.default_rng(0)
    knee = body._bones.index("lowerleg01.L")
    angles = np.degrees([body.sample_pose(rng)[knee, 0] for _ in range(100)])
    assert angles.min() >= 0.0
    assert angles.max() <= 110.0
