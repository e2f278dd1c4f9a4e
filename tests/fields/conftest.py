"""The catalogue of fields that the laws are tested on.

A test that takes `example` runs on every entry of the catalogue, `exact_example` on
those tagged exact, and `surface` on every primitive with an independent description of
its surface. `test_fields_laws.py` checks that no primitive and no operation of the
package is missing here. New entries go into a module of `tests/fields/catalogue`.
"""

from __future__ import annotations

import pkgutil
from importlib import import_module

import numpy as np
import pytest

from fields import Field
from tests.fields import catalogue as topics
from tests.fields.catalogue.surface import REACH, Surface

EXAMPLES: dict[str, Field] = {}
SURFACES: dict[str, Surface] = {}
for _module in pkgutil.iter_modules(topics.__path__, topics.__name__ + "."):
    if not _module.name.endswith(".surface"):
        _topic = import_module(_module.name)
        for _known, _new in ((EXAMPLES, _topic.EXAMPLES), (SURFACES, _topic.SURFACES)):
            assert not _known.keys() & _new.keys(), f"labels of {_module.name} that others use"
            _known.update(_new)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a test on the whole catalogue if it asks for an entry of it."""
    exact = {name: field for name, field in EXAMPLES.items() if field.exact}
    for argument, entries in (
        ("example", EXAMPLES),
        ("exact_example", exact),
        ("surface", SURFACES),
    ):
        if argument in metafunc.fixturenames:
            metafunc.parametrize(argument, entries.values(), ids=entries.keys())


@pytest.fixture
def catalogue() -> dict[str, Field]:
    """All examples by label."""
    return EXAMPLES


@pytest.fixture
def surfaces() -> dict[str, Surface]:
    """All primitives with a second description, by label."""
    return SURFACES


@pytest.fixture
def cloud(rng: np.random.Generator) -> np.ndarray:
    """Points `(8000, 3)` in the cube of half edge `REACH`, denser in the middle."""
    wide = rng.uniform(-REACH, REACH, (4_000, 3))
    return np.concatenate([wide, rng.uniform(-1.5, 1.5, (4_000, 3))])
