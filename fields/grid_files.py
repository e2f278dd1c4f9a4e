"""Grids of samples on disk: `.npy`, `.npz`, NRRD (`.nrrd`, `.nhdr`) and VTK images (`.vti`).

Nothing in a file is executed: pickles and XML entities are refused.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields import arguments
from fields.errors import InputError, MissingDependency
from fields.field import Field, make_field
from fields.grid import Interpolation, Outside, grid, grid_field
from fields.grid_oracle import GridOracle
from fields.grid_samples import DamagedFile, Samples, sampled
from fields.notation import recorded
from fields.vti import read_vti, write_vti
from fields.whole_files import atomic_write, refuse_target

_REMEDY = "check that the file is complete, or write it again"


def load_grid(
    path: str | os.PathLike[str],
    *,
    spacing: float | ArrayLike | None = None,
    origin: ArrayLike | None = None,
    interpolation: Interpolation = "linear",
    outside: Outside = "distance",
) -> Field:
    """A grid of samples from a file, as a field; see `grid`.

    * `.npy`: an array `(nx, ny, nz)`. It has no place, so `spacing` is needed.
    * `.npz`: arrays `values`, `spacing` (one number or three) and, if not zero, `origin`.
    * NRRD (`.nrrd`, `.nhdr`): space directions and origin are honoured, turned ones too.
    * `.vti`: VTK images with one array of numbers, or one that is active, at points or in cells
      (their middles are then the samples), as text, base64 or raw, compressed by zlib or not.

    Args:
        path: of the file.
        spacing: between samples, in place of the file's.
        origin: `(3,)`, place of the first sample, in place of the file's.
        interpolation: "linear" or "cubic".
        outside: "distance" or "clamp".

    Raises:
        InputError: there is no such file, it is of another kind, damaged or cut off, or its axes
            are not at right angles; or as for `grid`.
        MissingDependency: pynrrd, which reads NRRD, is not installed.
    """
    file = Path(path)
    if not file.is_file():
        raise InputError("path", str(file), "there is no such file", "check the path")
    try:
        samples = _format(file)[0](file)
    except (InputError, MissingDependency):
        raise
    except Exception as error:  # whatever a parser makes of a damaged file
        said = error if isinstance(error, DamagedFile) else f"it cannot be read ({error})"
        raise InputError("path", str(file), str(said), _REMEDY) from error
    values, first, turn, step = _squared(file, samples)
    if spacing is not None:
        step = np.array(arguments.numbers_or_one("spacing", spacing))
    elif np.isnan(step).any():
        _refuse(file, "it does not say how far samples are apart", "pass spacing=...")
    if origin is not None:
        first = np.array(arguments.vector("origin", origin))
    options = {"spacing": step, "interpolation": interpolation, "outside": outside}
    if np.array_equal(turn, np.eye(3)):
        field = grid(values, origin=first, **options)
    else:
        field = grid(values, **options).rotate(turn).translate(first)
    given = {"path": file, "spacing": spacing, "origin": origin}
    given |= {"interpolation": interpolation, "outside": outside}
    optional = {"spacing": None, "origin": None, "interpolation": "linear", "outside": "distance"}
    return make_field(field._body, recorded("load_grid", (), given, optional))


def save_grid(
    field: Field,
    path: str | os.PathLike[str],
    *,
    spacing: float | ArrayLike | None = None,
    bounds: ArrayLike | None = None,
) -> None:
    """Sample a field on a grid and write it to a `.npy`, `.npz`, `.nrrd` or `.vti` file.

    A field that `grid` made, unmoved, is written with its own samples, bit for bit, if neither
    spacing nor bounds are given. `load_grid` reads back the values, and except for `.npy` their
    places.

    Args:
        field: what to sample.
        path: of the file; written under a temporary name and renamed.
        spacing: between samples; one number, or three.
        bounds: the box `(2, 3)` to cover; the last samples may lie beyond it by less than a step.
            If None, the field's own and two steps more on every side.

    Raises:
        InputError: the file cannot be written there; no spacing; no bounds; NaN values.
        MissingDependency: pynrrd, which writes NRRD, is not installed.
    """
    file = Path(path)
    writer = _format(file)[1]
    refuse_target(file)
    samples = _own_samples(field) if spacing is None and bounds is None else None
    if samples is None:
        samples = sampled(field, spacing, bounds)
    with atomic_write(file) as temporary:
        writer(temporary, samples)


def _own_samples(field: Field) -> Samples | None:
    """The samples of a field that is a grid and nothing else, or None."""
    for instruction in field.tape.instructions:
        oracle = instruction.payload
        if isinstance(oracle, GridOracle):
            # The same formula is the same object.
            for outside in ("distance", "clamp"):
                again = grid_field(oracle, outside, field.history)
                if again.expression is field.expression:
                    return Samples(oracle.samples, oracle.origin, np.diag(oracle.spacing))
    return None


def _squared(
    file: Path, samples: Samples
) -> tuple[NDArray[np.generic], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Values, place of the first sample, rotation matrix and spacing of samples.

    An axis that would make the rotation a reflection is turned round.
    """
    values, origin, axes = samples.values, samples.origin, samples.axes
    if values.ndim != 3:
        shape = " x ".join(str(n) for n in values.shape)
        _refuse(file, f"it holds {shape} numbers, which is no volume", "write one array, 3 axes")
    step = np.linalg.norm(axes, axis=1)
    if np.isnan(step).any():
        return values, np.nan_to_num(origin), np.eye(3), step
    if not (np.isfinite(axes).all() and np.isfinite(origin).all() and (step > 0).all()):
        _refuse(file, f"its steps {axes.tolist()} or origin {origin.tolist()} are no places")
    turn = (axes / step[:, None]).T
    if np.abs(turn.T @ turn - np.eye(3)).max() > 1e-6:
        _refuse(file, f"its axes {axes.tolist()} are not at right angles", "resample it")
    if np.linalg.det(turn) < 0:
        # A permutation of axes and directions that is mostly along x, y, z becomes one of those.
        axis = int(np.argmin(turn.sum(axis=0)))
        origin = origin + axes[axis] * (values.shape[axis] - 1)
        values = np.flip(values, axis)
        turn[:, axis] *= -1
    return values, origin, turn, step


def _refuse(file: Path, cause: str, remedy: str = _REMEDY) -> NoReturn:
    raise InputError("path", str(file), cause, remedy)


# --- formats --------------------------------------------------------------------------


def _read_npy(file: Path) -> Samples:
    return Samples(np.load(file, allow_pickle=False), np.zeros(3), np.full((3, 3), np.nan))


def _write_npy(file: Path, samples: Samples) -> None:
    np.save(file, samples.values, allow_pickle=False)


def _read_npz(file: Path) -> Samples:
    with np.load(file, allow_pickle=False) as archive:
        names = set(archive.files)
        if unknown := names - {"values", "spacing", "origin"}:
            raise DamagedFile(
                f"it holds {', '.join(sorted(unknown))}, but only values, spacing and origin are "
                "known"
            )
        if "values" not in names:
            raise DamagedFile("it holds no array named values")
        spacing = archive["spacing"] if "spacing" in names else np.nan
        origin = archive["origin"] if "origin" in names else np.zeros(3)
        axes = np.diag(np.broadcast_to(np.asarray(spacing, np.float64), 3))
        return Samples(
            archive["values"],
            np.asarray(origin, np.float64).reshape(3),
            np.where(np.isnan(axes).any(), np.nan, axes),
        )


def _write_npz(file: Path, samples: Samples) -> None:
    spacing = np.linalg.norm(samples.axes, axis=1)
    np.savez_compressed(file, values=samples.values, spacing=spacing, origin=samples.origin)


def _read_nrrd(file: Path) -> Samples:
    values, header = _nrrd().read(str(file), index_order="F")
    axes = np.full((3, 3), np.nan)
    if "space directions" in header:
        axes = np.array(header["space directions"], dtype=np.float64)
    elif "spacings" in header:
        axes = np.diag(np.array(header["spacings"], dtype=np.float64))
    if values.ndim == 3 and axes.shape != (3, 3):
        raise DamagedFile(f"its axes {axes.tolist()} do not fit a volume")
    return Samples(values, np.array(header.get("space origin", np.zeros(3)), np.float64), axes)


def _write_nrrd(file: Path, samples: Samples) -> None:
    header = {
        "space dimension": 3,
        "space directions": samples.axes,
        "space origin": samples.origin,
        "encoding": "gzip",
    }
    if file.suffix.lower() == ".nhdr":
        _refuse(file, "its samples would be in a second file", "use .nrrd")
    _nrrd().write(str(file), samples.values, header, index_order="F")


def _nrrd() -> ModuleType:
    try:
        import nrrd
    except ImportError as error:
        raise MissingDependency(
            "pynrrd", "NRRD files", "Install it with `pip install pynrrd`"
        ) from error
    return nrrd


_Format = tuple[Callable[[Path], Samples], Callable[[Path, Samples], None]]

_FORMATS: dict[str, _Format] = {
    ".npy": (_read_npy, _write_npy),
    ".npz": (_read_npz, _write_npz),
    ".nrrd": (_read_nrrd, _write_nrrd),
    ".nhdr": (_read_nrrd, _write_nrrd),
    ".vti": (read_vti, write_vti),
}

VOLUMES = tuple(_FORMATS)
"""Suffixes of files that hold a grid."""


def _format(file: Path) -> _Format:
    suffix = file.suffix.lower()
    if suffix in _FORMATS:
        return _FORMATS[suffix]
    cause = f"files of the kind {suffix or '(no extension)'} hold no grid that is known here"
    if suffix == ".vdb":
        cause = "OpenVDB has no package for Python that installs everywhere"
    known = ", ".join(_FORMATS)
    _refuse(file, cause, f"convert it (ParaView does) to one of {known}")
