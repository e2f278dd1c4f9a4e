"""The thread that follows a drag, and solves in full after it.

While a handle is dragged, single steps of the solve are taken from where the map is, and the
preview mesh is carried forward every few of them: the newest target counts, and nothing queues up.
After it, the same solve runs that `implicit-warp deform` runs, from rest, with the same options, so
that the exported handle file gives the same map.

The full solve begins at rest, but the page does not fall back: what the drag has reached stays
until the solve comes closer to the handles.

Guarantees: every map that is shown is injective, whatever the steps did.  Errors of the solve go to
the listener; the thread goes on.  After `stop`, `rest`, `set_shape` or `close` has returned,
nothing of what was asked for before is shown.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fields import Field
from implicit_warp.elastic_solve import ElasticOptions, ElasticSolve, draw_samples
from implicit_warp.handles import Handle
from implicit_warp.sampling import Samples
from implicit_warp.warp import Warp

LOG = logging.getLogger("implicit_warp.viewer")

LIVE = {"samples": 768, "handle_samples": 128}
"""Options of the steps during a drag, in place of the full solve's."""

RATE, FALL, LEAST = 0.005, 0.98, 0.3
"""Their learning rate after an event, by what factor it falls with every update after that, and the
least share of it. A tenth of the full solve's: each step starts close to its goal, because the
rigid motion that serves all handles is followed at once; a larger rate shakes the shape."""

WARM_UP = 20
"""Steps over which the rate rises at first: Adam's first steps are as long as its rate."""

STEPS = 5
"""Steps between two updates of the page."""

ROUNDS = 40
"""Updates after the last event of a drag, before the thread waits for the next one."""


@dataclass(frozen=True, eq=False)
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
        handles: that it follows, or was solved for.
    """

    vertices: NDArray[np.float32]
    warp: Warp
    handle_error: float
    final: bool
    running: bool
    latency: float
    text: str
    handles: tuple[Handle, ...] = ()


@dataclass(frozen=True, eq=False)
class _Request:
    handles: tuple[Handle, ...]
    full: bool
    rounds: int
    epoch: int
    time: float


@dataclass(frozen=True, eq=False)
class _Shape:
    """What a thread's work belongs to: results for an earlier one are not shown."""

    field: Field
    vertices: NDArray[np.float32]


class _SupersededError(Exception):
    """Something newer was asked for."""


_Regions = tuple[tuple[Field, str], ...]


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
        # Held while something is shown, so that what ends showing can wait for that.
        self._showing = threading.RLock()
        self._request: _Request | None = None
        self._epoch = 0
        self._closed = self._busy = False
        self._live: tuple[_Shape, _Regions, ElasticSolve] | None = None
        self._start: tuple[_Shape, _Regions, ElasticSolve] | None = None
        self._drawn: tuple[_Shape, _Regions, Samples] | None = None
        self._steps = 0
        self._reached: Warp | None = None
        self.set_shape(field, vertices)
        self._thread = threading.Thread(target=self._run, name="solver", daemon=True)
        self._thread.start()

    def set_shape(self, field: Field, vertices: NDArray[np.floating]) -> None:
        """Another shape from now on."""
        shape = _Shape(field, np.ascontiguousarray(vertices, np.float32))
        with self._ending():
            self._shape, self._reached = shape, None

    def follow(self, handles: Sequence[Handle]) -> None:
        """Go on towards these, step by step; returns at once."""
        self._ask(handles, ROUNDS)

    def prepare(self, handles: Sequence[Handle]) -> None:
        """Make ready to follow these, so that the first event finds all samples drawn."""
        self._ask(handles, 0)

    def solve(self, handles: Sequence[Handle]) -> None:
        """Solve in full for these; returns at once."""
        self._ask(handles, 0, full=True)

    def stop(self) -> None:
        """Leave off what is being done."""
        with self._ending():
            pass

    def rest(self) -> None:
        """Leave off what is being done; what is shown from now on is the shape at rest."""
        with self._ending():
            self._reached = None

    def close(self) -> None:
        """End the thread."""
        with self._ending():
            self._closed = True
        if threading.current_thread() is not self._thread:
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

    @contextlib.contextmanager
    def _ending(self) -> Iterator[None]:
        with self._showing, self._changed:
            yield
            self._request = None
            self._epoch += 1
            self._changed.notify_all()

    def _ask(self, handles: Sequence[Handle], rounds: int, full: bool = False) -> None:
        now = time.perf_counter()
        with self._changed:
            if not self._closed:
                self._request = _Request(tuple(handles), full, rounds, self._epoch, now)
                self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._closed or self._request is not None)
                if self._closed:
                    return
                self._busy, request, shape = True, self._request, self._shape
            try:
                if request.full:
                    self._solve(request, shape)
                else:
                    self._follow(request, shape)
            except _SupersededError:
                pass
            except Exception as error:  # noqa: BLE001 - whatever it is, the page has to say it
                self._live = None
                self._tell(error)
            with self._changed:
                if self._request is request:
                    self._request = None

    def _tell(self, error: Exception) -> None:
        try:
            self._on_error(error)
        except Exception:  # the thread has to go on, whatever becomes of the page
            LOG.exception("an error of a solve could not be shown: %s", error)

    def _current(self, request: _Request) -> bool:
        with self._changed:
            return self._request is request

    def _follow(self, request: _Request, shape: _Shape) -> None:
        solve = self._stepped(request, shape)
        if not request.rounds:
            solve.rehearse()
            solve.warp()(shape.vertices)
        for round_ in range(request.rounds):
            warm = min(1.0, (self._steps + STEPS) / WARM_UP)
            solve.advance(STEPS, RATE * warm * max(FALL**round_, LEAST))
            self._steps += STEPS
            more = round_ < request.rounds - 1
            error = solve.handle_error()
            self._show(request, shape, solve.warp(), error, more, "following", first=round_ == 0)
            if not self._current(request):
                return

    def _stepped(self, request: _Request, shape: _Shape) -> ElasticSolve:
        """The solve to go on with: the last one, if the regions are still the same."""
        regions = _regions(request.handles)
        if _fits(self._live, shape, regions):
            self._live[2].retarget(request.handles)
        else:
            all_ = self._drawn_for(request, shape)
            few = [points[: LIVE["handle_samples"]] for points in all_.regions]
            options = self.options.with_changes(LIVE)
            solve = ElasticSolve(shape.field, request.handles, options, Samples(all_.interior, few))
            self._live, self._steps = (shape, regions, solve), 0
        if _fits(self._start, shape, regions):  # a full solve is the last that was shown
            self._live[2].start_from(self._start[2])
            self._steps = WARM_UP
        self._start = None
        return self._live[2]

    def _drawn_for(self, request: _Request, shape: _Shape) -> Samples:
        """The samples of a full solve, drawn once as long as the regions are the same."""
        regions = _regions(request.handles)
        if not _fits(self._drawn, shape, regions):
            samples = draw_samples(shape.field, request.handles, self.options)
            self._drawn = (shape, regions, samples)
        return self._drawn[2]

    def _solve(self, request: _Request, shape: _Shape) -> None:
        def watch() -> None:
            if not self._current(request):
                raise _SupersededError

        def review(step: int, warp: Warp) -> None:
            nonlocal reached, shown
            error = solve.handle_error()
            if error <= reached:
                reached, shown = math.inf, warp  # from now on whatever it does
            text = f"step {step} of {self.options.steps}"
            self._show(request, shape, shown, error, True, text)

        samples = self._drawn_for(request, shape)
        solve = ElasticSolve(shape.field, request.handles, self.options, samples)
        # A drag has come closer to the handles than the first steps from rest do.
        shown = self._reached
        reached = math.inf if shown is None else solve.handle_error(shown)
        warp = solve.run(callback=review, watch=watch)
        self._start = (shape, _regions(request.handles), solve)
        text = f"{warp.report.status} after {warp.report.steps} steps, {warp.report.seconds:.1f} s"
        self._show(request, shape, warp, warp.report.handle_error, False, text, final=True)

    def _show(
        self,
        request: _Request,
        shape: _Shape,
        warp: Warp,
        handle_error: float,
        running: bool,
        text: str,
        *,
        first: bool = False,
        final: bool = False,
    ) -> None:
        vertices = warp(shape.vertices)
        with self._showing:
            with self._changed:
                # During a drag something newer may be asked for already; a full solve is for its
                # own handles only.
                wanted = request.epoch == self._epoch and (
                    not request.full or self._request is request
                )
            if not wanted:
                return
            self._reached = warp
            latency = time.perf_counter() - request.time if first else math.nan
            self._on_update(
                Update(vertices, warp, handle_error, final, running, latency, text, request.handles)
            )


def _regions(handles: Sequence[Handle]) -> _Regions:
    return tuple((handle.region, handle.name) for handle in handles)


def _fits(made: tuple | None, shape: _Shape, regions: _Regions) -> bool:
    """Was something made for this shape and these very regions?"""
    return (
        made is not None
        and made[0] is shape
        and len(made[1]) == len(regions)
        and all(a[0] is b[0] and a[1] == b[1] for a, b in zip(made[1], regions, strict=True))
    )
