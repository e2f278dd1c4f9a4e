"""Certificates: of every map, in files, and never where there is no proof."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

import implicit_warp as iw
from implicit_warp.bend import Bend
from implicit_warp.certificate import Certificate, certify
from implicit_warp.cli import main
from implicit_warp.errors import FileFormatError, InputError
from implicit_warp.files import load, read_metadata, save
from implicit_warp.maps import Map
from implicit_warp.orientation import smallest_area
from implicit_warp.tuttenet import TutteNet
from implicit_warp.warp import Warp
from tests.implicit_warp.map_files import rewrite
from tests.implicit_warp.registered_maps import BUILDERS, random_affine, random_net, random_warp

MAPS = pytest.mark.parametrize("build", BUILDERS.values(), ids=BUILDERS.keys())
BOX = np.array([[-0.4, -0.3, -0.2], [0.3, 0.4, 0.5]])


@MAPS
@torch.no_grad()
def test_every_map_of_ours_is_proved_on_a_box_and_all_but_bends_everywhere(build, seed):
    for m in (build(seed), build(seed).inv):
        assert certify(m).proved == ("Bend" not in repr(m))
        assert certify(m).region is None
        on_box = certify(m, BOX)
        assert on_box.proved
        assert np.array_equal(on_box.region, BOX)
        assert str(on_box).startswith("proved injective on the box (-0.4, -0.3, -0.2) to ")
        # Its constants bound what is sampled, one on the box and one around its image.
        x = torch.from_numpy(np.random.default_rng(seed).uniform(*BOX, (200, 3)))
        y, jacobian = m.call_and_jacobian(x)
        assert torch.linalg.matrix_norm(jacobian, 2).max() <= on_box.lipschitz[0] * (1 + 1e-12)
        if on_box.lipschitz[1] is not None:
            back = torch.linalg.matrix_norm(m.inv.jacobian(y), 2).max()
            assert back <= on_box.lipschitz[1] * (1 + 1e-12)
        else:
            assert "Bend" in repr(m)


@MAPS
def test_certificates_are_plain_values_in_files(build, tmp_path, seed):
    m = build(seed)
    save(m, tmp_path / "map.safetensors")
    stored = json.loads(read_metadata(tmp_path / "map.safetensors")["certificate"])
    assert stored == json.loads(json.dumps(certify(m).to_dict(), allow_nan=False))
    assert stored["proved"] == ("Bend" not in repr(m))
    load(tmp_path / "map.safetensors")


@torch.no_grad()
def test_the_figures_of_a_warp_are_those_of_its_layers(seed):
    warp = random_warp(seed)
    certificate = certify(warp)
    # Cells of all layers, frames, and the two affine maps.
    signs = warp.n_layers * warp.mesh.n_cells + warp.n_layers + 2
    assert certificate.by_filter + certificate.exactly == signs
    exact = float(smallest_area(warp.embeddings.numpy(), warp.mesh))
    assert certificate.smallest_area == warp.smallest_area == exact
    assert certificate.smallest_area_sign == 1
    assert certificate.lipschitz == warp.lipschitz
    tables = warp.stack.tables[..., :4].unflatten(-1, (2, 2))
    singular = torch.linalg.svdvals(tables)
    for (low, high), of_layer in zip(certificate.singular_values, singular, strict=True):
        assert low <= min(float(of_layer.min()), 1.0) * (1 + 1e-12)
        assert low == pytest.approx(min(float(of_layer.min()), 1.0), rel=1e-9)
        assert high >= max(float(of_layer.max()), 1.0) * (1 - 1e-12)
        assert high == pytest.approx(max(float(of_layer.max()), 1.0), rel=1e-9)
    back = certify(warp.inv)
    assert back.lipschitz == certificate.lipschitz[::-1]
    assert back.singular_values[0] == tuple(1 / s for s in certificate.singular_values[-1][::-1])


@pytest.mark.parametrize("exponent", [-1000, -600, -300, 300, 480])
def test_layers_of_extreme_scale_are_proved_and_saved(exponent, tmp_path, seed):
    """Their areas leave the range of float64, and with them some bounds, but no sign."""
    net = random_net(seed, layers=2, resolution=4)
    u = torch.ldexp(net.embeddings().detach(), torch.tensor([[[0]], [[exponent]]]))
    warp = Warp(u, net.frames())
    for m in (warp, warp.inv):
        certificate = certify(m)
        assert certificate.proved
        assert certificate.smallest_area_sign == 1
        assert str(certificate)
        save(m, tmp_path / "map.safetensors")
        load(tmp_path / "map.safetensors")
        bounds = m.local_bounds(BOX[None])
        assert not np.isnan(bounds.lipschitz).any()
        assert not np.isnan(bounds.boxes).any()
        norm = np.linalg.norm(m.jacobian(BOX), 2, axis=(-2, -1)).max() if abs(exponent) < 400 else 0
        assert norm <= bounds.lipschitz[0] * (1 + 1e-12)


class Strange(Map):
    """A map of which nothing is known."""

    _forward = _inverse = lambda self, points: points
    _forward_and_jacobian = _inverse_and_jacobian = lambda self, points: (
        points,
        torch.eye(3).to(points).expand(len(points), 3, 3),
    )

    def __repr__(self) -> str:
        return "Strange()"


class Swears(Strange):
    """A map of another kind that brings its own proof."""

    def _certify(self, box):
        return Certificate("Swears()", True)


def test_without_a_proof_there_is_no_certificate_and_no_word_of_injective(seed):
    strange = Strange()
    for m in (strange, strange.inv, random_affine(seed) @ strange, (strange @ strange).inv):
        for box in (None, BOX):
            certificate = certify(m, box)
            assert not certificate.proved
            assert str(certificate).startswith("no certificate: ")
            assert "injective" not in str(certificate)
            assert certificate.to_dict()["lipschitz"] == [None, None]
    named = certify(random_affine(seed) @ strange)
    assert named.reason.startswith("part 0, Strange(): nothing is known")


def test_a_foreign_map_may_bring_its_own_proof(seed):
    assert certify(Swears()).proved
    assert certify(Swears().inv).proved
    assert certify(random_affine(seed) @ Swears()).proved


def test_a_net_that_diverged_has_no_certificate(seed):
    net = random_net(seed)
    net.theta_weights.data.fill_(torch.nan)
    assert str(certify(net)).startswith("no certificate: embeddings = ")


def test_boxes_are_pushed_through_a_composition(seed):
    """A bend after a shift: what counts is the box that reaches it."""
    bend = Bend(90.0, "z", between=(0.0, np.pi / 2), towards="x")  # defined for x < 1
    for shift, proved in ((0.6, True), (0.8, False)):
        both = bend @ iw.Affine(translation=(shift, 0.0, 0.0))
        assert certify(both, BOX).proved == proved
    refused = certify(both, BOX)
    assert refused.reason.startswith("part 1, Bend(")
    assert not certify(both).proved
    # Nothing bounds what a foreign map does to the box, so that the bend must take all of space.
    assert not certify(bend @ Swears(), BOX).proved
    assert not certify(bend @ random_warp(seed), 1e3 * BOX).proved


def test_bad_arguments_are_named(seed):
    with pytest.raises(InputError, match="not a map"):
        certify("warp")
    with pytest.raises(InputError, match="low corner"):
        certify(random_affine(seed), BOX[::-1])
    with pytest.raises(InputError, match="shape"):
        certify(random_affine(seed), [1.0, 2.0])


@pytest.fixture
def saved(tmp_path, seed):
    save(random_warp(seed), tmp_path / "warp.safetensors")
    return tmp_path / "warp.safetensors"


def test_one_changed_digit_is_found(saved):
    """Far too small a change to fold anything, or to move any figure of the certificate."""

    def nudge(_, tensors):
        u = tensors["0.embeddings"]
        u[2, 5, 0] = torch.nextafter(u[2, 5, 0], torch.tensor(9.0, dtype=u.dtype))

    rewrite(saved, nudge)
    with pytest.raises(FileFormatError, match="altered: its numbers"):
        load(saved)


@pytest.mark.parametrize(
    "change",
    [
        {"proved": False},
        {"smallest_area": 0.5},
        {"smallest_area": True},
        {"lipschitz": [1.0, 1.0]},
        {"lipschitz": [1.0]},
        {"singular_values": []},
        {"region": [[0, 0, 0], [1, 1, 1]]},
    ],
)
def test_an_altered_certificate_is_found(saved, change):
    def edit(metadata, _):
        values = json.loads(metadata["certificate"])
        metadata["certificate"] = json.dumps(values | change)

    rewrite(saved, edit)
    with pytest.raises(FileFormatError, match=f"altered: in its certificate, {next(iter(change))}"):
        load(saved)


@pytest.mark.parametrize("text", ["[]", "{}", "7", "{"])
def test_a_damaged_certificate_is_refused(saved, text):
    rewrite(saved, lambda metadata, _: metadata.update(certificate=text))
    with pytest.raises(FileFormatError):
        load(saved)


def test_files_from_before_there_were_certificates_still_load(saved, seed):
    def age(metadata, _):
        del metadata["certificate"], metadata["sha256"]

    rewrite(saved, age)
    x = torch.rand(5, 3, dtype=torch.float64)
    assert torch.equal(load(saved)(x), random_warp(seed)(x))


def test_info_shows_the_certificate(saved, tmp_path, capsys):
    assert main(["info", str(saved)]) == 0
    output = capsys.readouterr().out
    assert "certificate: proved injective on all of R^3" in output
    assert "decided in float64 with a proven error bound" in output
    assert "Lipschitz bounds: " in output
    save(Bend(90.0), tmp_path / "bend.safetensors")
    assert main(["info", str(tmp_path / "bend.safetensors")]) == 0
    assert "certificate: no certificate: a bend is" in capsys.readouterr().out


def test_making_a_warp_costs_little_more_than_before(seed):
    """The proof is part of every solve: 24 layers of 440 cells, against a bound ten times what it
    was measured to take."""
    import time

    net = TutteNet(24, 11, init="paper")
    u, frames = net.embeddings().detach(), net.frames()
    Warp(u, frames)
    times = []
    for _ in range(20):
        start = time.perf_counter()
        Warp(u, frames)._prove()
        times.append(time.perf_counter() - start)
    assert min(times) < 10e-3
