"""Map files: bit for bit, and nothing else is read as one."""

from __future__ import annotations

import os

import pytest
import torch
from safetensors.torch import save_file

import implicit_warp as iw
from implicit_warp.errors import FileFormatError, InputError, NotInjective
from implicit_warp.files import atomic_write, load, read_metadata, save
from implicit_warp.maps import Map
from tests.implicit_warp.map_files import rewrite
from tests.implicit_warp.registered_maps import BUILDERS, random_warp


@pytest.mark.parametrize("build", BUILDERS.values(), ids=BUILDERS.keys())
@torch.no_grad()
def test_maps_come_back_bit_for_bit(build, tmp_path, seed):
    m = build(seed)
    path = tmp_path / "map.safetensors"
    save(m, path, units="mm")
    again = load(path)
    x = 4.0 * torch.rand(100, 3, dtype=torch.float64) - 2.0
    assert torch.equal(again(x), m(x))
    assert torch.equal(again.inv(x), m.inv(x))
    assert type(again) is type(m)
    metadata = read_metadata(path)
    assert metadata["units"] == "mm"
    assert metadata["library_version"] == iw.__version__


def test_a_net_comes_back_trainable(tmp_path, seed):
    net = BUILDERS["net free"](seed)
    save(net, tmp_path / "net.safetensors")
    again = load(tmp_path / "net.safetensors")
    assert {n for n, _ in again.named_parameters()} == {n for n, _ in net.named_parameters()}
    assert all(p.requires_grad for p in again.parameters())


@pytest.fixture
def saved(tmp_path, seed):
    path = tmp_path / "warp.safetensors"
    save(random_warp(seed), path)
    return path


def test_truncated_file_is_refused(saved):
    saved.write_bytes(saved.read_bytes()[:-100])
    with pytest.raises(FileFormatError, match="may be truncated"):
        load(saved)


def test_other_contents_are_refused(saved, tmp_path):
    other = tmp_path / "other.safetensors"
    save_file({"a": torch.zeros(2)}, other)
    with pytest.raises(FileFormatError, match="holds no map"):
        load(other)
    other.write_text("hello")
    with pytest.raises(FileFormatError, match="not a readable"):
        load(other)
    with pytest.raises(InputError, match="no such file"):
        load(tmp_path / "none.safetensors")


def test_newer_version_is_refused_by_name(saved):
    rewrite(saved, lambda metadata, _: metadata.update(format_version="99"))
    with pytest.raises(FileFormatError, match=r"format version '99'.*reads 1"):
        load(saved)


def test_damaged_description_is_refused(saved):
    rewrite(saved, lambda metadata, _: metadata.update(structure='{"kind": "warp"}'))
    with pytest.raises(FileFormatError, match="description is damaged"):
        load(saved)


def test_tampered_vertices_are_found_on_load(saved):
    def fold(_, tensors):
        tensors["0.embeddings"][0, -1] += 3.0

    rewrite(saved, fold)
    with pytest.raises(NotInjective, match="layer 0"):
        load(saved)


def test_maps_without_a_format_are_refused(tmp_path):
    class Strange(Map):
        _forward = _inverse = lambda self, points: points
        _forward_and_jacobian = _inverse_and_jacobian = lambda self, points: (points, points)

    with pytest.raises(InputError, match="no file format"):
        save(Strange(), tmp_path / "map.safetensors")
    assert list(tmp_path.iterdir()) == []


@torch.no_grad()
def test_one_map_may_stand_twice_in_a_composition(tmp_path, seed):
    warp = random_warp(seed)
    both = warp @ iw.Affine() @ warp
    save(both, tmp_path / "map.safetensors")
    x = torch.rand(5, 3, dtype=torch.float64)
    assert torch.equal(load(tmp_path / "map.safetensors")(x), both(x))


@pytest.mark.parametrize(
    "structure",
    ['{"kind": "warp", "tensors": 3}', '{"kind": "cube", "tensors": {}}', "[" * 100_000, "7", "{}"],
)
def test_no_description_does_more_than_be_refused(saved, structure):
    rewrite(saved, lambda metadata, _: metadata.update(structure=structure))
    with pytest.raises(FileFormatError):
        load(saved)


def test_values_that_are_not_finite_are_refused(saved):
    rewrite(saved, lambda _, tensors: tensors["1.frames"].fill_(float("nan")))
    with pytest.raises(FileFormatError, match="NaN"):
        load(saved)


def test_frames_that_are_no_rotations_are_refused(saved):
    rewrite(saved, lambda _, tensors: tensors["1.frames"].mul_(3.0))
    with pytest.raises(FileFormatError, match="rotations"):
        load(saved)


def test_a_link_stays_a_link_and_permissions_stay(tmp_path):
    real, link = tmp_path / "real.txt", tmp_path / "link.txt"
    real.write_text("old")
    real.chmod(0o640)
    link.symlink_to(real)
    with atomic_write(link) as temporary:
        temporary.write_text("new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    assert real.stat().st_mode & 0o777 == 0o640


def test_a_failed_write_keeps_the_old_file_and_leaves_nothing_else(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def crash_halfway():
        with atomic_write(path) as temporary:
            temporary.write_text("half a fi")
            raise RuntimeError("power cut")

    with pytest.raises(RuntimeError, match="power cut"):
        crash_halfway()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]
    with atomic_write(path) as temporary:
        temporary.write_text("new")
        assert temporary.suffix == ".txt"
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_impossible_targets_are_named(tmp_path):
    for path, words in [(tmp_path / "no" / "a.stl", "does not exist"), (tmp_path, "is a folder")]:
        with pytest.raises(InputError, match=words), atomic_write(path):
            pass


@pytest.mark.parametrize("key", ["sha256", "certificate"])
def test_a_certificate_without_its_fingerprint_is_refused(key, saved):
    rewrite(saved, lambda metadata, _: metadata.pop(key))
    with pytest.raises(FileFormatError, match="one is missing"):
        load(saved)


def test_units_belong_to_the_fingerprint(saved):
    rewrite(saved, lambda metadata, _: metadata.update(units="parsec"))
    with pytest.raises(FileFormatError, match="altered"):
        load(saved)
