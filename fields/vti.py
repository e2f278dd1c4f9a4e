"""VTK image files (`.vti`), read and written without VTK.

Read: one piece, numbers as text, base64 or raw, inline or appended, compressed by zlib or not.
Written: raw float32 or float64 at points, appended, little-endian.
"""

from __future__ import annotations

import base64
import re
import zlib
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from fields.grid_samples import DamagedFile, Samples

_TYPES = {f"{sign}{bits}": f"{code}{bits // 8}" for sign, code in (("Int", "i"), ("UInt", "u"))
          for bits in (8, 16, 32, 64)} | {"Float32": "f4", "Float64": "f8"}  # fmt: skip

_APPENDED = re.compile(rb"<AppendedData[^>]*>\s*_")


def read_vti(path: Path) -> Samples:
    """The active array of an image, or the only one.

    Raises:
        DamagedFile: it is no such image, or incomplete.
    """
    content = path.read_bytes()
    if b"<!DOCTYPE" in content[:4096] or b"<!ENTITY" in content[:4096]:
        raise DamagedFile("it declares entities, which no image needs")
    found = _APPENDED.search(content)
    appended = content[found.end() :] if found else b""
    text = content[: found.start()] + b"</VTKFile>" if found else content
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise DamagedFile(f"it is not complete XML ({error})") from error
    image = root.find("ImageData")
    pieces = [] if image is None else image.findall("Piece")
    if image is None or len(pieces) != 1:
        raise DamagedFile(f"it holds {len(pieces)} pieces of an image, not one")
    extent = np.array(pieces[0].get("Extent", "").split(), dtype=int).reshape(3, 2)
    at_points, array = _array(pieces[0])
    shape = np.diff(extent, axis=1)[:, 0] + (1 if at_points else 0)
    if (shape < 1).any():
        raise DamagedFile(f"its extent {extent.tolist()} holds nothing")
    base64_appended = bool(found) and b'"base64"' in found.group()
    values = _Decoder(root, appended, base64_appended).numbers(array, int(np.prod(shape)))
    spacing = _triple(image, "Spacing", "1 1 1")
    direction = np.array(image.get("Direction", "1 0 0 0 1 0 0 0 1").split(), dtype=np.float64)
    axes = direction.reshape(3, 3).T * spacing[:, None]
    first = extent[:, 0] + (0.0 if at_points else 0.5)
    origin = _triple(image, "Origin", "0 0 0") + first @ axes
    # The first axis varies fastest in the file.
    return Samples(values.reshape(shape[::-1]).transpose(), origin, axes)


def _triple(element: Element, name: str, default: str) -> NDArray[np.float64]:
    numbers = np.array(element.get(name, default).split(), dtype=np.float64)
    if numbers.shape != (3,):
        raise DamagedFile(f"its {name} has {len(numbers)} numbers, not three")
    return numbers


def _array(piece: Element) -> tuple[bool, Element]:
    """The array to read, and whether its values are at points."""
    arrays = [
        (at_points, array, array.get("Name") == group.get("Scalars"))
        for kind, at_points in (("PointData", True), ("CellData", False))
        for group in piece.findall(kind)
        for array in group.findall("DataArray")
        if array.get("NumberOfComponents", "1") == "1"
    ]
    chosen = [item for item in arrays if item[2]] or arrays
    if len(chosen) != 1:
        names = ", ".join(repr(array.get("Name", "")) for _, array, _ in arrays)
        raise DamagedFile(
            "it holds no array of single numbers"
            if not arrays
            else f"it holds several arrays ({names}) and says of none that it is the active one"
        )
    return chosen[0][0], chosen[0][1]


class _Decoder:
    """Turns the arrays of a file into numbers."""

    def __init__(self, root: Element, appended: bytes, base64_appended: bool) -> None:
        compressor = root.get("compressor", "")
        if compressor not in ("", "vtkZLibDataCompressor"):
            raise DamagedFile(f"it is compressed by {compressor}, and only zlib is read here")
        self._compressed = bool(compressor)
        self._order = ">" if root.get("byte_order") == "BigEndian" else "<"
        self._header = np.dtype(self._order + _TYPES[root.get("header_type", "UInt32")])
        self._appended, self._base64_appended = appended, base64_appended

    def numbers(self, array: Element, count: int) -> NDArray[np.generic]:
        """So many numbers."""
        code = _TYPES.get(array.get("type", ""))
        if code is None:
            raise DamagedFile(f"numbers of type {array.get('type')} are not read here")
        kind = array.get("format", "ascii")
        if kind == "ascii":
            values = np.array((array.text or "").split(), dtype=code)
        else:
            values = np.frombuffer(self._content(array, kind), dtype=self._order + code)
            values = values.astype(code)
        if len(values) != count:
            raise DamagedFile(f"it holds {len(values)} numbers, and its extent asks for {count}")
        return values

    def _content(self, array: Element, kind: str) -> bytes:
        if kind == "appended":
            stream = self._appended[int(array.get("offset", "0")) :]
            if self._base64_appended:
                stream = _from_base64(stream.partition(b"<")[0])
        else:
            stream = _from_base64((array.text or "").encode())
        size = self._header.itemsize
        if not self._compressed:
            (length,) = self._heads(stream, 1)
            return self._exactly(stream[size:], length)
        blocks = self._heads(stream, 1)[0]
        heads = self._heads(stream, 3 + blocks)
        at, parts = size * len(heads), []
        for length in heads[3:]:
            parts.append(zlib.decompress(self._exactly(stream[at:], length)))
            at += length
        return b"".join(parts)

    def _heads(self, stream: bytes, count: int) -> list[int]:
        if count > len(stream):
            raise DamagedFile("it is cut off")
        content = self._exactly(stream, count * self._header.itemsize)
        return [int(number) for number in np.frombuffer(content, dtype=self._header)]

    @staticmethod
    def _exactly(stream: bytes, length: int) -> bytes:
        if length > len(stream):
            raise DamagedFile(f"it is cut off: {length} bytes are announced, {len(stream)} left")
        return stream[:length]


def _from_base64(text: bytes) -> bytes:
    """Decode what may be several encodings in a row, each with its own padding."""
    parts = re.findall(rb"[^=]+=*", b"".join(text.split()))
    return b"".join(base64.b64decode(part) for part in parts)


def write_vti(path: Path, samples: Samples) -> None:
    """Write samples at points."""
    values = samples.values
    number = "Float32" if values.dtype == np.float32 else "Float64"
    content = values.astype("<" + _TYPES[number]).tobytes(order="F")
    extent = " ".join(f"0 {n - 1}" for n in values.shape)
    spacing = np.linalg.norm(samples.axes, axis=1)
    direction = (samples.axes / spacing[:, None]).T

    def said(numbers: NDArray[np.float64]) -> str:
        return " ".join(repr(float(x)) for x in numbers.reshape(-1))

    header = f"""<?xml version="1.0"?>
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
  <ImageData WholeExtent="{extent}" Origin="{said(samples.origin)}" Spacing="{said(spacing)}" \
Direction="{said(direction)}">
    <Piece Extent="{extent}">
      <PointData Scalars="distance">
        <DataArray type="{number}" Name="distance" format="appended" offset="0"/>
      </PointData>
    </Piece>
  </ImageData>
  <AppendedData encoding="raw">
   _"""
    length = len(content).to_bytes(8, "little")
    path.write_bytes(header.encode() + length + content + b"\n  </AppendedData>\n</VTKFile>\n")
