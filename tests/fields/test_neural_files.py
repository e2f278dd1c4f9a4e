"""Learned fields on disk: bit for bit, and damage of every kind is told apart."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

import fields as sdf
from fields import FileFormatError, HashGrid, InputError, Siren
from fields.neural import files
from fields.neural.leaf import NeuralOracle, neural_field, neural_leaf
from tests.fields.catalogue.neural import BOX, tiny_network

POINTS = np.random.default_rng(0).uniform(-2, 2, (500, 3))


def _field(architecture=None):
    network = tiny_network(architecture or HashGrid(2, 2, 5, 6, 8, 1))
    return neural_field(NeuralOracle(network, BOX, lipschitz=2.5, steepness=1.5))


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "sdf.safetensors"
    sdf.save_neural(_field(), path)
    return path


def _rewrite(path, change_tensors=None, **metadata):
    """The file with some things replaced, by the library that anybody would edit it with."""
    tensors = load_file(path)
    with safe_open(path, framework="pt") as file:
        before = file.metadata()
    if change_tensors is not None:
        change_tensors(tensors)
    save_file(tensors, path, metadata={**before, **metadata})


@pytest.mark.parametrize("architecture", [HashGrid(2, 2, 5, 6, 8, 1), Siren(8, 2, 3.0)])
def test_a_saved_field_comes_back_bit_for_bit(architecture, tmp_path):
    field, path = _field(architecture), tmp_path / "sdf.safetensors"
    sdf.save_neural(field, path)
    loaded = sdf.load_neural(path)
    np.testing.assert_array_equal(loaded(POINTS), field(POINTS))
    assert loaded.lipschitz == field.lipschitz
    np.testing.assert_array_equal(loaded.bounds, field.bounds)
    assert neural_leaf(loaded).network.architecture == architecture
    assert repr(loaded) == f"load_neural({str(path)!r})"
    again = sdf.parse(repr(loaded), allow_files=True)
    np.testing.assert_array_equal(again(POINTS), field(POINTS))
    with pytest.raises(InputError, match="not permitted"):
        sdf.parse(repr(loaded))


def test_only_networks_as_they_came_are_saved(tmp_path):
    path = tmp_path / "sdf.safetensors"
    for field in (sdf.sphere(1), _field().translate((1, 0, 0)), _field() | sdf.sphere(1), "field"):
        with pytest.raises(InputError, match="not just a network"):
            sdf.save_neural(field, path)
    assert not path.exists()


def test_a_failed_write_leaves_the_old_file(saved, monkeypatch):
    before = saved.read_bytes()

    def fail(*args, **kwargs):
        raise OSError("disk full")

    monkeypatch.setattr("safetensors.torch.save_file", fail)
    with pytest.raises(OSError, match="disk full"):
        sdf.save_neural(_field(), saved)
    assert saved.read_bytes() == before
    assert [p.name for p in saved.parent.iterdir()] == [saved.name]


def test_a_report_is_kept_beside_the_field(tmp_path):
    options = {"batch": 64, "gradient_batch": 8, "near_samples": 500, "box_samples": 500}
    field, report = sdf.fit_neural(sdf.sphere(1), Siren(8, 1), steps=2, **options)
    sdf.save_neural(field, tmp_path / "a.safetensors", report)
    _, facts = files.read(tmp_path / "a.safetensors", files.NEURAL)
    assert facts["report"] == json.loads(json.dumps(report.to_dict()))


def _flip(tensors):
    tensors["table"][3, 0] += 1e-3


def _nan(tensors):
    tensors["table"][3, 0] = torch.nan


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda p: p.write_bytes(p.read_bytes()[:-50]), "truncated"),
        (lambda p: p.write_bytes(b""), "not a readable"),
        (lambda p: p.write_text("solid cube"), "not a readable"),
        (lambda p: _rewrite(p, _flip), "altered or damaged"),
        (lambda p: _rewrite(p, facts="{}"), "altered or damaged"),
        (lambda p: _rewrite(p, format_version="7"), "format version '7'"),
        (lambda p: _rewrite(p, format="implicit_warp.map"), "holds no learned field; it is a map"),
        (lambda p: _rewrite(p, format="other"), "unknown format 'other'"),
        (lambda p: save_file({"a": torch.zeros(1)}, p), "unknown format None"),
    ],
)
def test_damage_is_told_apart(saved, damage, message):
    damage(saved)
    with pytest.raises(FileFormatError, match=message):
        sdf.load_neural(saved)


@pytest.mark.parametrize(
    "change",
    [
        lambda tensors, facts: facts["architecture"].update(levels=3),
        lambda tensors, facts: facts["architecture"].update(kind="tower"),
        lambda tensors, facts: facts.pop("box"),
        lambda tensors, facts: tensors.pop("table"),
        lambda tensors, facts: _nan(tensors),
    ],
)
def test_a_description_that_does_not_fit_is_damaged(saved, change):
    """Even with a right fingerprint, as another program might write it."""
    tensors, facts = files.read(saved, files.NEURAL)
    change(tensors, facts)
    files.write(saved, files.NEURAL, tensors, facts)
    with pytest.raises(FileFormatError, match="description is damaged"):
        sdf.load_neural(saved)


def test_a_missing_file_and_a_wrong_suffix_are_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        sdf.load_neural(tmp_path / "none.safetensors")
    with pytest.raises(InputError, match="cannot write"):
        sdf.save_neural(_field(), tmp_path / "sdf.pt")


def test_files_of_families_are_not_fields(tmp_path, saved):
    with pytest.raises(FileFormatError, match="it is a learned field"):
        sdf.Family.load(saved)
