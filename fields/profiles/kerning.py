"""How much nearer or farther two glyphs stand than their widths say.

Read from a font's GPOS table, feature "kern", pair adjustments only (OpenType specification,
"GPOS", lookup type 2), or from its "kern" table if there is none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

Kerning = Callable[[str, str], float]
"""The change of the distance between two glyphs, by their names, in the font's units."""

_PAIRS, _EXTENSION = 2, 9


def kerning(font: Any) -> Kerning:
    """The pair kerning of an open fontTools font."""
    lookups = _pair_lookups(font["GPOS"].table) if "GPOS" in font else []
    if lookups:
        return lambda left, right: sum(_adjusted(subtables, left, right) for subtables in lookups)
    tables = [table.kernTable for table in font["kern"].kernTables] if "kern" in font else []
    return lambda left, right: sum(table.get((left, right), 0) for table in tables)


def _pair_lookups(table: Any) -> list[list[Any]]:
    """The subtables of every pair lookup of the feature, lookups in the order of the font."""
    if table.FeatureList is None or table.LookupList is None:
        return []
    used = {
        index
        for record in table.FeatureList.FeatureRecord
        if record.FeatureTag == "kern"
        for index in record.Feature.LookupListIndex
    }
    found = []
    for index in sorted(used):
        subtables = [
            subtable.ExtSubTable if subtable.LookupType == _EXTENSION else subtable
            for subtable in table.LookupList.Lookup[index].SubTable
        ]
        found.append([subtable for subtable in subtables if subtable.LookupType == _PAIRS])
    return [subtables for subtables in found if subtables]


def _adjusted(subtables: list[Any], left: str, right: str) -> float:
    """By the first subtable that applies; one by classes applies to every pair it covers."""
    for subtable in subtables:
        if left not in subtable.Coverage.glyphs:
            continue
        if subtable.Format == 1:
            pairs = subtable.PairSet[subtable.Coverage.glyphs.index(left)].PairValueRecord
            for pair in pairs:
                if pair.SecondGlyph == right:
                    return _advance(pair.Value1)
            continue
        first = subtable.ClassDef1.classDefs.get(left, 0)
        second = subtable.ClassDef2.classDefs.get(right, 0)
        return _advance(subtable.Class1Record[first].Class2Record[second].Value1)
    return 0.0


def _advance(value: Any) -> float:
    return getattr(value, "XAdvance", 0) or 0
