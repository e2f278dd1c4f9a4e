"""The state of an edit: handles and selection, with undo, redo and listeners.

One session serves all tabs.  Every change goes through `EditSession.change`, under a lock, from one
immutable state to the next; so undoing is going back to an earlier state, and no tab sees half of a
change.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fields import Field
from implicit_warp.errors import InputError
from implicit_warp.handles import (
    Handle,
    hold,
    load_handles,
    move,
    refuse_equal_names,
    save_handles,
)
from implicit_warp.viewer.regions import selected

MOST_UNDO = 200
"""States that are kept."""

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class EditHandle:
    """A region and what becomes of it.

    Attributes:
        name: unique in the edit.
        region: what it holds of the shape at rest.
        pivot: (3,) the centre of its rotation, and where its gizmo starts.
        held: does it stay in place?
        rotvec: rotation vector in degrees, about the pivot.
        shift: (3,) translation, after the rotation.
        weight: of the handle in the solve.
        visible: is it coloured in the page?
    """

    name: str
    region: Field
    pivot: Triple
    held: bool
    rotvec: Triple = (0.0, 0.0, 0.0)
    shift: Triple = (0.0, 0.0, 0.0)
    weight: float = 1.0
    visible: bool = True

    def posed(self, position: np.ndarray, wxyz: np.ndarray) -> EditHandle:
        """The handle moved so that a gizmo that was at the pivot, unturned, has this pose."""
        turn = Rotation.from_quat(np.asarray(wxyz, np.float64), scalar_first=True)
        shift = np.asarray(position, np.float64) - self.pivot
        return replace(
            self,
            rotvec=_triple(turn.as_rotvec(degrees=True)),
            shift=_triple(shift),
            held=False,
        )

    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """The gizmo's position (3,) and wxyz (4,)."""
        turn = Rotation.from_rotvec(self.rotvec, degrees=True)
        return np.add(self.pivot, self.shift), turn.as_quat(scalar_first=True)

    def about(self, pivot: np.ndarray) -> EditHandle:
        """The same motion, with its gizmo and the centre of its rotation at another place."""
        turn = Rotation.from_rotvec(self.rotvec, degrees=True)
        old, new = np.array(self.pivot), np.array(_triple(pivot))
        shift = turn.apply(new - old) + old + self.shift - new
        return replace(self, pivot=_triple(new), shift=_triple(shift))

    def handle(self, amount: float = 1.0) -> Handle:
        """For a solve, with a share of its motion: the same words that a handle file has."""
        if self.held:
            return hold(self.region, name=self.name, weight=self.weight)
        degrees = float(np.linalg.norm(self.rotvec))
        words: dict = {"translate": _triple(amount * np.array(self.shift))}
        if amount * degrees > 1e-9:
            axis = _triple(np.array(self.rotvec) / degrees)
            words["rotate"] = (axis, _rounded(amount * degrees))
            words["pivot"] = self.pivot
        return move(self.region, name=self.name, weight=self.weight, **words)


@dataclass(frozen=True)
class EditState:
    """All that undo brings back.

    Attributes:
        handles: in the order in which they were made.
        selection: what is picked, if anything is.
        active: name of the handle that has the gizmo; empty for none.
    """

    handles: tuple[EditHandle, ...] = ()
    selection: Field | None = None
    active: str = ""

    @property
    def chosen(self) -> EditHandle | None:
        """The handle that has the gizmo, if one has."""
        return next((h for h in self.handles if h.name == self.active), None)

    def get(self, name: str) -> EditHandle:
        """The handle of a name.

        Raises:
            InputError: there is none.
        """
        for handle in self.handles:
            if handle.name == name:
                return handle
        names = ", ".join(h.name for h in self.handles) or "none yet"
        raise InputError("handle", name, "no handle has this name", f"there are: {names}")

    def with_handle(self, handle: EditHandle, old: str | None = None) -> EditState:
        """A handle entered, or put in the place of the one that is called `old`."""
        others = [h for h in self.handles if h.name != (old or handle.name)]
        if any(h.name == handle.name for h in others):
            raise InputError("name", handle.name, "another handle has this name", "name them apart")
        if len(others) == len(self.handles):
            return replace(self, handles=(*self.handles, handle), active=handle.name)
        place = [h.name for h in self.handles].index(old or handle.name)
        handles = (*others[:place], handle, *others[place:])
        active = handle.name if self.active == (old or handle.name) else self.active
        return replace(self, handles=handles, active=active)

    def without(self, name: str) -> EditState:
        """A handle removed."""
        self.get(name)
        kept = tuple(h for h in self.handles if h.name != name)
        return replace(self, handles=kept, active="" if self.active == name else self.active)

    def free_name(self, kind: str) -> str:
        """A name like "held 2" that no handle has."""
        names = {h.name for h in self.handles}
        return next(f"{kind} {i}" for i in range(1, len(names) + 2) if f"{kind} {i}" not in names)

    @property
    def moves(self) -> bool:
        """Is anything moved at all?"""
        return any(not h.held for h in self.handles)

    @property
    def displaced(self) -> bool:
        """Is anything elsewhere than at rest?"""
        return any(not h.held and any((*h.rotvec, *h.shift)) for h in self.handles)


class EditSession:
    """An edit that several tabs share.

    Attributes:
        revision: grows by one with every change.
    """

    def __init__(self, state: EditState | None = None) -> None:
        self._lock = threading.RLock()
        self._states, self._at = [state or EditState()], 0
        self._merging: str | None = None
        self._listeners: list[Callable[[EditState], None]] = []
        self.revision = 0

    @property
    def state(self) -> EditState:
        """As it is now."""
        with self._lock:
            return self._states[self._at]

    def listen(self, listener: Callable[[EditState], None]) -> None:
        """Call this after every change, in the thread that made it and in the changes' order."""
        with self._lock:
            self._listeners.append(listener)

    def change(self, how: Callable[[EditState], EditState], merge: str | None = None) -> EditState:
        """From one state to the next, which can be undone.

        Args:
            how: gives the next state; what it raises leaves everything as it was.
            merge: changes in a row with the same text, a drag's say, are undone as one.
        """
        with self._lock:
            following = how(self.state)
            if following is self.state:
                return following
            keep = self._at + (0 if merge is not None and merge == self._merging else 1)
            self._states = [*self._states[:keep], following][-MOST_UNDO:]
            self._at, self._merging = len(self._states) - 1, merge
            return self._told()

    def end_merging(self) -> None:
        """The next change is a step of its own."""
        with self._lock:
            self._merging = None

    def undo(self) -> EditState:
        """One change back, if there is one."""
        return self._go(-1)

    def redo(self) -> EditState:
        """One change on again, if one was undone."""
        return self._go(1)

    def reset(self) -> EditState:
        """Nothing moves; the regions stay. Can be undone."""
        none = (0.0, 0.0, 0.0)

        def at_rest(state: EditState) -> EditState:
            if all(h.rotvec == none and h.shift == none for h in state.handles):
                return state
            handles = tuple(replace(h, rotvec=none, shift=none) for h in state.handles)
            return replace(state, handles=handles)

        return self.change(at_rest)

    def _go(self, way: int) -> EditState:
        with self._lock:
            at = min(max(self._at + way, 0), len(self._states) - 1)
            self._merging = None
            if at == self._at:
                return self.state
            self._at = at
            return self._told()

    def _told(self) -> EditState:
        """Tell all listeners, also after one that raises; its error comes when all know."""
        self.revision += 1
        state, errors = self.state, []
        for listener in self._listeners:
            try:
                listener(self.state)  # one before it may have made another change
            except Exception as error:  # noqa: BLE001 - raised below
                errors.append(error)
        if errors:
            raise errors[0]
        return state


def solve_handles(state: EditState, amount: float = 1.0) -> list[Handle]:
    """The handles as a solve takes them.

    Raises:
        InputError: there are none.
    """
    if not state.handles:
        raise InputError(
            "handles", 0, "nothing is held or moved yet", "select a region, then hold or move it"
        )
    return [handle.handle(amount) for handle in state.handles]


def same_task(first: Sequence[Handle], second: Sequence[Handle]) -> bool:
    """Do two lists of handles ask a solve for the same map?"""
    return len(first) == len(second) and all(
        a.region is b.region and a.weight == b.weight and dict(a.words) == dict(b.words)
        for a, b in zip(first, second, strict=True)
    )


def save_edit(state: EditState, path: str | Path, solve: dict | None = None) -> None:
    """Write the handle file that `implicit-warp deform` reads."""
    save_handles(path, solve_handles(state), solve)


def load_edit(path: str | Path, vertices: np.ndarray) -> tuple[EditState, dict]:
    """The handles of a file, and the options of its solve.

    Args:
        path: the handle file.
        vertices: (n, 3) of the shape at rest; pivots go to the middle of those selected.

    Raises:
        InputError: see `load_handles`; two handles have one name.
    """
    handles, options = load_handles(path)
    refuse_equal_names(handles)
    edits = []
    for handle in handles:
        picked = vertices[selected(handle.region, vertices)]
        middle = picked.mean(axis=0) if len(picked) else np.zeros(3)
        matrix = handle.motion.matrix.numpy()
        rotvec = Rotation.from_matrix(matrix[:, :3]).as_rotvec(degrees=True)
        pivot = np.asarray(_triple(middle))
        shift = matrix[:, :3] @ pivot + matrix[:, 3] - pivot
        edits.append(
            EditHandle(
                handle.name,
                handle.region,
                _triple(pivot),
                handle.is_held,
                _triple(rotvec),
                _triple(shift),
                handle.weight,
            )
        )
    return EditState(tuple(edits), None, edits[-1].name), options


def _rounded(value: float) -> float:
    """As it is written to files: nine digits, so that what is solved is what is saved."""
    return float(f"{float(value):.9g}")


def _triple(values) -> Triple:
    return tuple(_rounded(v) for v in np.asarray(values, np.float64))
