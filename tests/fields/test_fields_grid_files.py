"""Grids on disk: what was written is read, what others write too, and damage is named."""

from __future__ import annotations

import base64
import pickle
import sys
import zlib

import numpy as np
import pytest

import fields as sdf
from fields import InputError, MissingDependency
from tests.fields.catalogue.leaves import NOISE

nrrd = pytest.importorskip("nrrd", reason="reads and writes NRRD")

SPACING, ORIGIN = (1.0, 0.5, 0.25), (1.0, -2.0, 3.0)
FIELD = sdf.grid(NOISE, spacing=SPACING, origin=ORIGIN)
POINTS = np.random.default_rng(0).uniform(-4, 8, (500, 3))


# --- what we write ---


@pytest.mark.parametrize("suffix", ["npz", "nrrd", "vti", "npy"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_grid_comes_back_bit_for_bit(suffix, dtype, tmp_path):
    path = tmp_path / f"grid.{suffix}"
    field = sdf.grid(NOISE.astype(dtype), spacing=SPACING, origin=ORIGIN)
    sdf.save_grid(field, path)
    place = {"spacing": SPACING, "origin": ORIGIN} if suffix == "npy" else {}
    again = sdf.load_grid(path, **place)
    np.testing.assert_array_equal(again(POINTS), field(POINTS))
    assert (again.lipschitz, again.bounds.tolist()) == (field.lipschitz, field.bounds.tolist())
    parsed = sdf.parse(f"{again!r}.offset(0.1)", allow_files=True)
    np.testing.assert_array_equal(parsed(POINTS), field(POINTS) - 0.1)


def test_options_are_written_and_read(tmp_path):
    path = tmp_path / "grid.npz"
    sdf.save_grid(FIELD, path)
    field = sdf.load_grid(path, interpolation="cubic", outside="clamp", origin=(0, 0, 0))
    assert repr(field) == (
        f"load_grid({str(path)!r}, origin=(0.0, 0.0, 0.0), interpolation='cubic', outside='clamp')"
    )
    clamped = sdf.grid(NOISE, spacing=SPACING, interpolation="cubic", outside="clamp")
    np.testing.assert_allclose(field(POINTS), clamped(POINTS), atol=1e-12)


def test_text_from_anywhere_may_not_read_files(tmp_path):
    with pytest.raises(InputError, match="not permitted"):
        sdf.parse(f"load_grid({str(tmp_path / 'grid.npz')!r})")


@pytest.mark.parametrize("field", [sdf.torus(1.0, 0.3), FIELD.translate((0.1, 0, 0)) | FIELD])
def test_any_field_can_be_sampled_and_saved(field, tmp_path):
    path = tmp_path / "field.npz"
    sdf.save_grid(field, path, spacing=(0.1, 0.2, 0.15))
    again = sdf.load_grid(path)
    with np.load(path) as archive:
        axes = [archive["origin"][a] + archive["spacing"][a] * np.arange(n)
                for a, n in enumerate(archive["values"].shape)]  # fmt: skip
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    np.testing.assert_allclose(again(lattice), field(lattice), atol=1e-12)
    low, high = field.bounds
    assert (lattice[0, 0, 0] <= low).all()
    assert (lattice[-1, -1, -1] >= high - 1e-9).all()


def test_a_field_needs_a_spacing_and_bounds_to_be_sampled(tmp_path):
    with pytest.raises(InputError, match="the field is no grid"):
        sdf.save_grid(sdf.sphere(1), tmp_path / "a.npz")
    with pytest.raises(InputError, match="unbounded"):
        sdf.save_grid(sdf.below(0), tmp_path / "a.npz", spacing=0.1)
    box = ((-1, -1, -1), (1, 1, 1))
    sdf.save_grid(sdf.below(0), tmp_path / "a.npz", spacing=0.5, bounds=box)
    assert sdf.load_grid(tmp_path / "a.npz")([0.1, 0.2, 0.3]) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("name", "cause"),
    [("a.vdb", "OpenVDB"), ("a.raw", "no grid that is known"), ("no/a.npz", "does not exist"),
     ("a.nhdr", "a second file")],
)  # fmt: skip
def test_files_that_cannot_be_written_are_named(name, cause, tmp_path):
    with pytest.raises(InputError, match=cause):
        sdf.save_grid(FIELD, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


# --- what others write ---


def _vti(values, encoding, *, compressed=False, order="<", header="UInt32", cells=False):
    """A VTK image as VTK writes it, in each of its encodings."""
    kind = {"f8": "Float64", "f4": "Float32", "i2": "Int16", "u1": "UInt8"}[values.dtype.str[1:]]
    size = np.dtype(order + {"UInt32": "u4", "UInt64": "u8"}[header])
    content = values.astype(values.dtype.newbyteorder(order)).tobytes(order="F")
    if compressed:
        half = len(content) // 2 or 1
        blocks = [content[i : i + half] for i in range(0, len(content), half)]
        last = len(blocks[-1]) % half
        packed = [zlib.compress(block) for block in blocks]
        heads = np.array([len(blocks), half, last, *map(len, packed)], size).tobytes()
        content = b"".join(packed)
    else:
        heads = np.array([len(content)], size).tobytes()
    joined = (
        base64.b64encode(heads) + base64.b64encode(content)
        if compressed
        else base64.b64encode(heads + content)
    )
    body, end = "", b""
    if encoding == "ascii":
        body, how = " ".join(map(str, values.reshape(-1, order="F"))), 'format="ascii"'
    elif encoding == "base64":
        body, how = joined.decode(), 'format="binary"'
    else:
        how = 'format="appended" offset="3"'
        stream = b"???" + (heads + content if encoding == "raw" else joined)
        kind_of = "raw" if encoding == "raw" else "base64"
        end = b'<AppendedData encoding="%s">\n _%s\n</AppendedData>' % (kind_of.encode(), stream)
    group, ends = ("CellData", 1) if cells else ("PointData", 0)
    extent = " ".join(f"2 {2 + n - 1 + ends}" for n in values.shape)
    zlib_name = 'compressor="vtkZLibDataCompressor"' if compressed else ""
    return (
        f'<?xml version="1.0"?><VTKFile type="ImageData" version="1.0" header_type="{header}" '
        f'byte_order="{"LittleEndian" if order == "<" else "BigEndian"}" {zlib_name}>'
        f'<ImageData WholeExtent="{extent}" Origin="0 0 0" Spacing="1 0.5 0.25">'
        f'<Piece Extent="{extent}"><{group} Scalars="d">'
        f'<DataArray type="Float32" Name="other" format="ascii"></DataArray>'
        f'<DataArray type="{kind}" Name="d" {how}>{body}</DataArray>'
        f"</{group}></Piece></ImageData>"
    ).encode() + end + b"</VTKFile>"  # fmt: skip


@pytest.mark.parametrize("encoding", ["ascii", "base64", "raw", "appended base64"])
@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("header", ["UInt32", "UInt64"])
@pytest.mark.parametrize("dtype", ["f8", "i2"])
def test_every_encoding_of_vtk_is_read(encoding, compressed, order, header, dtype, tmp_path):
    values = (100 * NOISE).astype(dtype)
    path = tmp_path / "image.vti"
    path.write_bytes(_vti(values, encoding, compressed=compressed, order=order, header=header))
    field = sdf.load_grid(path)
    # The first sample is number (2, 2, 2) of the whole.
    lattice = np.argwhere(np.ones(values.shape, bool))
    found = field((lattice + 2) * [1, 0.5, 0.25])
    np.testing.assert_allclose(found, values.reshape(-1), atol=1e-11)


def test_cells_of_vtk_are_samples_at_their_middles(tmp_path):
    path = tmp_path / "image.vti"
    path.write_bytes(_vti(NOISE, "raw", cells=True))
    assert sdf.load_grid(path)([2.5, 1.25, 0.625]) == pytest.approx(NOISE[0, 0, 0])


def test_a_turned_vtk_image_is_turned(tmp_path):
    path = tmp_path / "image.vti"
    turned = _vti(NOISE, "raw").replace(
        b'Origin="0 0 0"', b'Origin="5 6 7" Direction="0 -1 0 1 0 0 0 0 1"'
    )
    path.write_bytes(turned)
    field = sdf.load_grid(path)
    index = np.array([1, 3, 2]) + 2
    x, y, z = index * [1, 0.5, 0.25]
    assert field([5 - y, 6 + x, 7 + z]) == pytest.approx(NOISE[1, 3, 2])


@pytest.mark.parametrize("encoding", ["raw", "gzip", "ascii"])
def test_nrrd_directions_are_honoured(encoding, tmp_path):
    """Permuted, turned and mirrored axes, as scanners write them."""
    path = tmp_path / "scan.nrrd"
    directions = np.array([[0, -1.5, 0], [0, 0, 2.0], [0.5, 0, 0]])
    header = {
        "space": "left-posterior-superior",
        "space directions": directions,
        "space origin": [10.0, 20.0, 30.0],
        "encoding": encoding,
    }
    nrrd.write(str(path), NOISE, header, index_order="F")
    field = sdf.load_grid(path)
    index = np.argwhere(np.ones(NOISE.shape, bool))
    values = field(index @ directions + [10, 20, 30])
    np.testing.assert_allclose(values, NOISE.reshape(-1), atol=1e-12)
    mirrored = {**header, "space directions": directions * [[1], [-1], [1]]}
    nrrd.write(str(path), NOISE, mirrored, index_order="F")
    values = sdf.load_grid(path)(index @ mirrored["space directions"] + [10, 20, 30])
    np.testing.assert_allclose(values, NOISE.reshape(-1), atol=1e-12)


def test_nrrd_spacings_are_honoured(tmp_path):
    path = tmp_path / "scan.nrrd"
    nrrd.write(str(path), NOISE.astype("i2"), {"spacings": [1.0, 2.0, 3.0]})
    assert sdf.load_grid(path)([3.0, 2.0, 9.0]) == NOISE.astype("i2")[3, 1, 3]


# --- damage ---


def _npz(tmp_path, **arrays):
    np.savez(tmp_path / "grid.npz", **arrays)
    return tmp_path / "grid.npz"


@pytest.mark.parametrize(
    ("arrays", "cause"),
    [
        ({"values": NOISE, "spacing": 1.0, "level": 3}, "holds level, but only values"),
        ({"sdf": NOISE, "spacing": 1.0}, "holds sdf, but only values"),
        ({"spacing": 1.0}, "no array named values"),
        ({"values": NOISE}, "how far samples are apart"),
        ({"values": NOISE, "spacing": (1.0, 2.0)}, "cannot be read"),
        ({"values": NOISE, "spacing": -1.0, "origin": (0, 0)}, "cannot be read"),
        ({"values": NOISE, "spacing": 0.0}, "are no places"),
        ({"values": NOISE, "spacing": np.inf}, "are no places"),
        ({"values": NOISE, "spacing": 1.0, "origin": (0, 0, np.inf)}, "are no places"),
        ({"values": NOISE[0], "spacing": 1.0}, "no volume"),
        ({"values": NOISE * np.nan, "spacing": 1.0}, "NaN"),
        ({"values": np.array([[[{}]]]), "spacing": 1.0}, "cannot be read"),
    ],
)
def test_bad_archives_are_named(arrays, cause, tmp_path):
    with pytest.raises(InputError, match=cause):
        sdf.load_grid(_npz(tmp_path, **arrays))


def test_npy_needs_a_spacing(tmp_path):
    np.save(tmp_path / "grid.npy", NOISE)
    with pytest.raises(InputError, match="how far samples are apart") as caught:
        sdf.load_grid(tmp_path / "grid.npy")
    assert "spacing" in caught.value.remedy


def test_pickles_are_not_opened(tmp_path):
    class Trap:
        def __reduce__(self):
            return (pytest.fail, ("a pickle was opened",))

    (tmp_path / "grid.npy").write_bytes(pickle.dumps(Trap()))
    np.savez(tmp_path / "grid.npz", values=np.array([[[Trap()]]], dtype=object), spacing=1.0)
    for name in ("grid.npy", "grid.npz"):
        with pytest.raises(InputError, match="cannot be read"):
            sdf.load_grid(tmp_path / name)


@pytest.mark.parametrize("suffix", ["npy", "npz", "nrrd", "vti"])
def test_cut_and_empty_files_are_refused(suffix, tmp_path):
    whole = tmp_path / f"grid.{suffix}"
    sdf.save_grid(FIELD, whole)
    content = whole.read_bytes()
    for length in (0, 10, len(content) // 3, len(content) // 2, len(content) - 60):
        cut = tmp_path / f"cut.{suffix}"
        cut.write_bytes(content[:length])
        with pytest.raises(InputError) as caught:
            sdf.load_grid(cut, spacing=1.0)
        assert str(cut) in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "cause"),
    [
        (b"Float64", b"String", "type String are not read"),
        (b'type="Float64"', b'type="Int8"', "1680 numbers, and its extent asks for 210"),
        (b"vtkZLibDataCompressor", b"vtkLZ4DataCompressor", "only zlib"),
        (b'Scalars="d"', b"", "several arrays"),
        (b'Spacing="1 0.5 0.25"', b'Spacing="1"', "1 numbers, not three"),
        (b'Spacing="1 0.5 0.25"', b'Spacing="1 0 1"', "are no places"),
        (b'Spacing="1 0.5 0.25"', b'Direction="1 0 0 1 1 0 0 0 1"', "not at right angles"),
        (b"<Piece", b"<Part", "not complete XML"),
        (b"ImageData", b"PolyData", "0 pieces"),
        (b"<?xml", b'<!DOCTYPE a [<!ENTITY b "c">]><?xml', "entities"),
        (b'"2 7 2 6 2 8"><PointData', b'"7 2 2 6 2 8"><PointData', "holds nothing"),
    ],
)
def test_other_vtk_files_are_named(old, new, cause, tmp_path):
    content = _vti(NOISE, "base64", compressed=True)
    assert old in content
    path = tmp_path / "image.vti"
    path.write_bytes(content.replace(old, new))
    with pytest.raises(InputError, match=cause):
        sdf.load_grid(path)


def test_a_volume_of_vectors_is_refused(tmp_path):
    path = tmp_path / "vectors.nrrd"
    nrrd.write(str(path), np.zeros((3, 4, 4, 4)))
    with pytest.raises(InputError, match="no volume"):
        sdf.load_grid(path)


def test_files_that_are_not_there_are_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        sdf.load_grid(tmp_path / "none.npz")
    (tmp_path / "a.vdb").write_bytes(b"")
    with pytest.raises(InputError, match="OpenVDB"):
        sdf.load_grid(tmp_path / "a.vdb")


def test_a_missing_pynrrd_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "nrrd", None)
    with pytest.raises(MissingDependency, match="pip install pynrrd"):
        sdf.save_grid(FIELD, tmp_path / "a.nrrd")
