"""The thread that follows a drag, and solves in full after it.

While a handle is dragged, single steps of the solve are taken from where the map is, and the
preview mesh is carried forward every few of them: the newest target counts, and nothing queues up.
After it, the same solve runs that `implicit-warp deform` runs, from rest, with the same options, so
that the exported handle file gives the same map.

Guarantee: every map that is shown is injective, whatever the steps did.  Errors of the solve go to
the listener; the thread goes on.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fields import Field
from implicit_warp.elastic_solve import ElasticOptions, ElasticSolve, elastic
from implicit_warp.handles import Handle
from implicit_warp.warp import Warp

LIVE = {"samples": 768, "handle_samples": 128}
"""Options of the steps during a drag, in place of the full solve's."""

RATE, FALL, LEAST = 0.04, 0.93, 0.05
"""Their learning rate after an event, by what factor it falls with every update after that, and the
least share of it: while nothing moves, the shape comes to rest."""

WARM_UP = 20
"""Steps over which the rate rises at first: Adam's first steps are as long as its rate."""

STEPS = 5
"""Steps between two updates of the page."""

ROUNDS = 40
"""Updates after the last event of a drag, before the thread waits for the next one."""


@dataclass(frozen=True)
class Update:
    """What the page shows next.

    Attributes:
        vertices: (n, 3) float32, the preview mesh under the map.
        warp: the map.
        handle_error: root mean square, in the user's units.
        final: is it the result of the full solve?
        running: is more to come?
        latency: seconds since the event of a drag, in the first update after it; else nan.
        text: of the progress, or of the result.
    """

    vertices: NDArray[np.float32]
    warp: Warp
    handle_error: float
    final: bool
    running: bool
    latency: float
    text: str


@dataclass(frozen=True)
class _Request:
    handles: tuple[Handle, ...]
    full: bool
    time: float
    rounds: int = ROUNDS


class _SupersededError(Exception):
    """Something newer was asked for."""


class LiveSolver:
    """Follows handles in a thread of its own.

    Args:
        field: the shape at rest.
        vertices: (n, 3) of its preview mesh.
        on_update: called in the thread with every `Update`.
        on_error: called in the thread with what a solve raised.
        options: of the full solve.
    """

    def __init__(
        self,
        field: Field,
        vertices: NDArray[np.floating],
        on_update: Callable[[Update], None],
        on_error: Callable[[Exception], None],
        options: ElasticOptions | None = None,
    ) -> None:
        self.options = options or ElasticOptions()
        self._on_update, self._on_error = on_update, on_error
        self._changed = threading.Condition()
        self._request: _Request | None = None
        self._closed = self._busy = False
        self._live: tuple[Any, ElasticSolve] | None = None
        self._steps = 0
        self.set_shape(field, vertices)
        self._thread = threading.Thread(target=self._run, name="solver", daemon=True)
        self._thread.start()

    def set_shape(self, field: Field, vertices: NDArray[np.floating]) -> None:
        """Another shape from now on."""
        with self._changed:
            self._field = field
            self._vertices = np.ascontiguousarray(vertices, np.float32)
            self._live = self._request = None

    def follow(self, handles: Sequence[Handle]) -> None:
        """Go on towards these, step by step; returns at once."""
        self._ask(_Request(tuple(handles), False, time.perf_counter()))

    def prepare(self, handles: Sequence[Handle]) -> None:
        """Make ready to follow these, so that the first event finds all samples drawn."""
        self._ask(_Request(tuple(handles), False, time.perf_counter(), rounds=0))

    def solve(self, handles: Sequence[Handle]) -> None:
        """Solve in full for these; returns at once."""
        self._ask(_Request(tuple(handles), True, time.perf_counter()))

    def stop(self) -> None:
        """Leave off what is being done."""
        with self._changed:
            self._request = None
            self._changed.notify_all()

    def close(self) -> None:
        """End the thread."""
        with self._changed:
            self._closed, self._request = True, None
            self._changed.notify_all()
        self._thread.join(timeout=30)

    def wait(self, timeout: float = 60.0) -> bool:
        """Wait until nothing is left to do; returns whether that is so."""
        with self._changed:
            return self._changed.wait_for(lambda: self._request is None and not self._busy, timeout)

    @property
    def busy(self) -> bool:
        """Is something being done?"""
        with self._changed:
            return self._busy or self._request is not None

    def _ask(self, request: _Request) -> None:
        with self._changed:
            self._request = request
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._closed or self._request is not None)
                if self._closed:
                    return
                self._busy, request = True, self._request
            try:
                if request.full:
                    self._solve(request)
                else:
                    self._follow(request)
            except _SupersededError:
                pass
            except Exception as error:  # noqa: BLE001 - whatever it is, the page has to say it
                self._live = None
                self._on_error(error)
            with self._changed:
                if self._request is request:
                    self._request = None

    def _current(self, request: _Request) -> bool:
        with self._changed:
            return self._request is request

    def _follow(self, request: _Request) -> None:
        solve = self._stepped(request)
        for round_ in range(request.rounds):
            warm = min(1.0, (self._steps + STEPS) / WARM_UP)
            solve.advance(STEPS, RATE * warm * max(FALL**round_, LEAST))
            self._steps += STEPS
            last = round_ == request.rounds - 1
            latency = float("nan") if round_ else time.perf_counter() - request.time
            self._show(solve.warp(), solve.handle_error(), not last, "following", latency)
            if not self._current(request):
                return

    def _stepped(self, request: _Request) -> ElasticSolve:
        """The solve to go on with: the last one, if the regions are still the same."""
        regions = tuple((h.region, h.name) for h in request.handles)
        if self._live is not None and _same(self._live[0], regions):
            self._live[1].retarget(request.handles)
            return self._live[1]
        options = self.options.with_changes(LIVE)
        solve = ElasticSolve(self._field, request.handles, options)
        self._live, self._steps = (regions, solve), 0
        return solve

    def _solve(self, request: _Request) -> None:
        def report(step: int, warp: Warp) -> None:
            if not self._current(request):
                raise _SupersededError
            text = f"step {step} of {self.options.steps}"
            self._show(warp, float("nan"), True, text)

        warp = elastic(
            self._field, request.handles, options=self.options, progress=False, callback=report
        )
        text = f"{warp.report.status} after {warp.report.steps} steps, {warp.report.seconds:.1f} s"
        self._show(warp, warp.report.handle_error, False, text, final=True)

    def _show(
        self,
        warp: Warp,
        handle_error: float,
        running: bool,
        text: str,
        latency: float = float("nan"),
        final: bool = False,
    ) -> None:
        vertices = warp(self._vertices)
        self._on_update(Update(vertices, warp, handle_error, final, running, latency, text))


def _same(old, new) -> bool:
    return len(old) == len(new) and all(
        a[0] is b[0] and a[1] == b[1] for a, b in zip(old, new, strict=True)
    )
