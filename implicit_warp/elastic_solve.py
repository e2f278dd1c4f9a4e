"""Elastic deformation: the injective map that follows the handles with least distortion.

Minimised over the parameters of a TutteNet f (paper, sec. 4.1),

    w_e  mean over the shape's inside of || J^T J - I ||^2
  + w_h  mean over the handles' points of | f(p) - R(p) |^2 / radius^2
  + w_r  mean over the same points of || J - R ||^2
  + w_l  mean over the layers of their own elastic energy.

The first is the elastic energy, a Monte-Carlo integral whose points are drawn more densely where
the distortion is high and weighted accordingly; the second pulls the handles to their targets, and
is measured in the unit domain; the third asks the map to turn the handles as it moves them; the
last keeps single layers well conditioned.  The paper prints no values for its weights; the defaults
of `ElasticOptions` were chosen on the field's four standard deformation tests.

The solve works in a unit domain and around the rigid motion that serves all handles best, so that
a twist by 135 degrees is asked of the net as half of it either way; the result is a map in the
user's own units.

Guarantee: the result is injective whatever the optimiser does.  Non-guarantee: the handles are met
in the least-squares sense, and the minimum found is a local one; the report says how close it came.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import torch
from torch import Tensor

from fields import Field
from implicit_warp import evaluate
from implicit_warp.alignment import best_affine_map
from implicit_warp.energy import elastic_energy, layer_energy
from implicit_warp.errors import InputError
from implicit_warp.handles import Handle, refuse_equal_names
from implicit_warp.layers import compose_affine, determinant_3x3, invert_affine
from implicit_warp.maps import Map
from implicit_warp.options import Options
from implicit_warp.progress import progress_bar
from implicit_warp.sampling import Samples, refuse_contradictions, sample_shape
from implicit_warp.threads import threads_for_steps
from implicit_warp.tuttenet import TutteNet
from implicit_warp.warp import Warp

_POOL = 1 << 15
"""Interior points from which each step draws its sample."""

_REVIEW = 25
"""Steps between reviews, which measure the whole pool, keep the best state and renew the sampling
density."""

_UNIT_RADIUS = 0.7
"""Radius of the handles and shape in the unit domain, whose square layers reach to 1: what lies
near a layer's border can only slide along it."""


@dataclass(frozen=True)
class ElasticOptions(Options):
    """Options of `elastic`; a handle file's ``[solve]`` table uses the same names.

    Attributes:
        layers, resolution, frames, boundary: of the TutteNet.
        steps: at most so many Adam steps.
        samples: interior points a step.
        handle_samples: points of each handle.
        learning_rate: at the start; it falls to nearly zero along a half cosine.
        elastic_weight, handle_weight, rotation_weight, layer_weight: see the module's text.
        tolerance: stop when the loss fell by less than this fraction over the last 100 steps.
        seed: of sampling and of the symmetry-breaking start.
        device: where to compute; "cuda" where there is one.
    """

    layers: int = 24
    resolution: int = 11
    frames: str = "cubic"
    boundary: str = "free"
    steps: int = 400
    samples: int = 2048
    handle_samples: int = 512
    learning_rate: float = 0.05
    elastic_weight: float = 1.0
    handle_weight: float = 1000.0
    rotation_weight: float = 1.0
    layer_weight: float = 1e-3
    tolerance: float = 1e-3
    seed: int = 0
    device: str = "cpu"

    def __post_init__(self) -> None:
        self._check_counts("layers", "steps", "samples", "handle_samples")
        self._check_seed(self.seed)
        self._check_numbers("elastic_weight", "handle_weight", "rotation_weight", "layer_weight")
        self._check_numbers("tolerance")
        self._check_numbers("learning_rate", positive=True)
        self._check_device(self.device)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> ElasticOptions:
        """From a ``[solve]`` table; unknown names are refused."""
        return cls().with_changes(values)


@dataclass(frozen=True)
class SolveReport:
    """What a solve reached, measured on all sampled points after the last step.

    Attributes:
        status: "converged", "stopped at the step limit" or "interrupted".
        steps: Adam steps taken.
        seconds: wall-clock time of the solve.
        loss: the four terms, unweighted, and their weighted "total".
        handle_error: root-mean-square distance of handle points from their targets, user's units.
        handle_error_relative: the same over the diagonal of the shape's bounds.
        handles: per handle "rms" and "max" distance, user's units.
        smallest_determinant: smallest det J over the sampled points.
        history: (step, total loss) at each review.
        options: the options used.
    """

    status: str
    steps: int
    seconds: float
    loss: dict[str, float]
    handle_error: float
    handle_error_relative: float
    handles: dict[str, dict[str, float]]
    smallest_determinant: float
    history: list[tuple[int, float]] = field(repr=False)
    options: dict[str, Any] = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> SolveReport:
        """The inverse of `to_dict`."""
        history = [(int(step), float(loss)) for step, loss in values["history"]]
        return cls(**{**values, "history": history})


def elastic(
    shape: Field,
    handles: Sequence[Handle],
    *,
    options: ElasticOptions | None = None,
    progress: bool | None = None,
    callback: Callable[[int, Warp], None] | None = None,
    **changes: Any,
) -> Warp:
    """Find the injective map that moves the handles and distorts the shape least.

    Args:
        shape: a field with finite bounds, or a closed mesh.
        handles: made by `hold` and `move`, at least one.
        options: all options at once; single ones may be given by keyword instead or on top.
        progress: True or False to show a bar or not; None shows it on a terminal.
        callback: called with (step, current map) at every review.
        **changes: options by name, see `ElasticOptions`.

    Returns:
        A `Warp` in the shape's own units; ``warp.report`` is the `SolveReport`. On Ctrl-C, the
        best map so far, with the report's status "interrupted".

    Raises:
        InputError: options out of range; a shape that is empty or unbounded; handles that select
            nothing or contradict each other.
    """
    options = (options or ElasticOptions()).with_changes(changes)
    with progress_bar("elastic", progress) as update, _stepping(options):
        return ElasticSolve(shape, handles, options).run(update=update, callback=callback)


@contextlib.contextmanager
def _stepping(options: ElasticOptions) -> Iterator[None]:
    """Gradients, whatever mode the caller is in, and as many threads as steps can use."""
    with torch.inference_mode(False), torch.enable_grad(), threads_for_steps(options.samples):
        yield


def _checked(handles: Any) -> list[Handle]:
    handles = [handles] if isinstance(handles, Handle) else list(handles)
    for handle in handles:
        if not isinstance(handle, Handle):
            raise InputError("handles", handle, "not a handle", "make it with iw.hold or iw.move")
    if not handles:
        raise InputError(
            "handles", handles, "nothing is held or moved", "pass iw.hold(...) and iw.move(...)"
        )
    refuse_equal_names(handles)
    return handles


def _as_field(shape: Any) -> Field:
    if isinstance(shape, Field):
        return shape
    if hasattr(shape, "vertices") and hasattr(shape, "faces"):
        from fields import mesh

        return mesh(shape)
    raise InputError("shape", shape, "neither a field nor a mesh", "pass a fields.Field")


def draw_samples(shape: Field, handles: Sequence[Handle], options: ElasticOptions) -> Samples:
    """The points that a solve of these works on; they do not depend on the handles' motions.

    Raises:
        InputError: see `elastic`.
    """
    pool = max(_POOL, options.samples)
    return sample_shape(
        _as_field(shape), _checked(handles), pool, options.handle_samples, options.seed
    )


class ElasticSolve:
    """One solve: samples, the unit domain, the net, and the loop.

    `elastic` makes one and runs it. An editor keeps one and takes single steps (`advance`), while
    the handles are dragged (`retarget`): the net then starts from where it is, or from where
    another solve has got to (`start_from`).

    Args:
        shape, handles, options: see `elastic`.
        samples: of `draw_samples`, for the same shape and regions; drawn if not given.

    Raises:
        InputError: see `elastic`.
    """

    def __init__(
        self,
        shape: Field,
        handles: Sequence[Handle],
        options: ElasticOptions,
        samples: Samples | None = None,
    ) -> None:
        self.options = options
        shape, handles = _as_field(shape), _checked(handles)
        if samples is None:
            samples = draw_samples(shape, handles, options)
        else:
            refuse_contradictions(handles, samples.regions, shape.bounds)
        self._samples = samples
        self.diagonal = float(torch.tensor(shape.bounds).diff(dim=0).norm())
        self._set_domain()
        self.retarget(handles)
        self.net = TutteNet(
            options.layers, options.resolution, options.frames, options.boundary
        ).to(options.device)
        self.generator = torch.Generator().manual_seed(options.seed)
        self._break_symmetry()
        self._set_density(torch.full((len(self.pool),), 1.0 / len(self.pool)).double())
        self._optimiser: torch.optim.Adam | None = None

    def _set_domain(self) -> None:
        """Choose the unit domain."""
        points = torch.cat([self._samples.interior, *self._samples.regions])
        centre = 0.5 * (points.amin(0) + points.amax(0))
        radius = float((points - centre).norm(dim=-1).max())
        if radius == 0.0:
            raise InputError("shape", self.diagonal, "all of its points coincide", "give it a size")
        self.unit = _UNIT_RADIUS / radius
        scale = torch.eye(3, dtype=torch.float64) * self.unit
        self._into_unit = torch.cat([scale, -self.unit * centre[:, None]], -1)

    def retarget(self, handles: Sequence[Handle]) -> None:
        """Other motions and weights for the same regions; the net stays as it is.

        Args:
            handles: as many as before, in the same order.
        """
        samples, device, before = self._samples, self.options.device, self._into_unit
        self.handles = list(handles)
        targets = [h.motion(p) for h, p in zip(self.handles, samples.regions, strict=True)]
        source, target = torch.cat(samples.regions), torch.cat(targets)
        common = best_affine_map(source, target, "rigid")
        after = compose_affine(common, invert_affine(before))
        self.before, self.after = before.to(device), after.to(device)
        # Into the unit domain in float64, and only there to float32: far from the origin, or at
        # any scale, nothing is lost.
        back = invert_affine(after)
        self.pool, self.sources, self.targets = (
            (points @ matrix[:, :3].T + matrix[:, 3]).to(device, torch.float32)
            for points, matrix in ((samples.interior, before), (source, before), (target, back))
        )
        sizes = [len(p) for p in samples.regions]
        self.region_slices = [slice(sum(sizes[:i]), sum(sizes[: i + 1])) for i in range(len(sizes))]
        rotations = [
            (common[:, :3].T @ h.motion.matrix[:, :3]).expand(n, 3, 3)
            for h, n in zip(self.handles, sizes, strict=True)
        ]
        self.rotations = torch.cat(rotations).to(device, torch.float32)
        # Every handle counts alike however many points it got, times its own weight.
        shares = [
            torch.full((n,), h.weight / (n * len(sizes)))
            for h, n in zip(self.handles, sizes, strict=True)
        ]
        self.shares = torch.cat(shares).to(device)

    def advance(self, steps: int, learning_rate: float) -> None:
        """So many steps from where the net is, at one rate."""
        with _stepping(self.options):
            if self._optimiser is None:
                self._optimiser = torch.optim.Adam(self.net.parameters(), fused=True)
            for group in self._optimiser.param_groups:
                group["lr"] = learning_rate
            for _ in range(steps):
                self._step(self._optimiser)

    def _step(self, optimiser: torch.optim.Optimizer) -> None:
        optimiser.zero_grad(set_to_none=True)
        self._loss(self._draw()).backward()
        optimiser.step()

    def start_from(self, other: ElasticSolve) -> None:
        """Go on from another solve's net of the same kind, as its own steps would."""
        self.net.load_state_dict(other.net.state_dict())
        self._optimiser = None
        if other._optimiser is not None:
            # Without its moments, Adam's first steps are as long as its rate, however little is
            # left to do.
            self._optimiser = torch.optim.Adam(self.net.parameters(), fused=True)
            self._optimiser.load_state_dict(other._optimiser.state_dict())

    def rehearse(self) -> None:
        """Take a step that changes nothing, so that the first true one finds all kernels loaded."""
        state, optimiser = self.generator.get_state(), self._optimiser
        self._optimiser = None
        self.advance(1, 0.0)
        self.generator.set_state(state)
        self._optimiser = optimiser

    @torch.no_grad()
    def handle_error(self, map: Map | None = None) -> float:
        """Root-mean-square distance of the handles' points from their targets, user's units.

        Args:
            map: that the points follow; the net as it is now, if none is given.
        """
        if map is None:
            image = evaluate.forward(self.net.stack(), self.sources)
            distance = (image - self.targets).double() / self.unit
        else:
            regions = zip(self.handles, self._samples.regions, strict=True)
            distance = torch.cat([map(points) - h.motion(points) for h, points in regions])
        return float(distance.square().sum(-1).mean().sqrt())

    def _break_symmetry(self) -> None:
        # At the identity all layers of one frame have the same gradient, and would move as one.
        with torch.no_grad():
            for parameter in self.net.parameters():
                noise = torch.randn(parameter.shape, generator=self.generator, dtype=torch.float64)
                parameter += 0.01 * noise.to(parameter.device)

    def run(
        self,
        *,
        update: Callable[[int, int, str], None] | None = None,
        callback: Callable[[int, Warp], None] | None = None,
        watch: Callable[[], None] | None = None,
    ) -> Warp:
        """The loop; returns the best state found.

        Args:
            update: called at every review with the step, the most steps and a text.
            callback: called at every review with the step and the current map.
            watch: called before every step; what it raises ends the solve.
        """
        with _stepping(self.options):
            return self._run(update, callback, watch)

    def _run(self, update, callback, watch) -> Warp:
        options = self.options
        optimiser = torch.optim.Adam(self.net.parameters(), lr=options.learning_rate, fused=True)
        self._optimiser = optimiser
        schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, self._rate)
        best_loss, best_state = math.inf, None
        history: list[tuple[int, float]] = []
        status, start, step = "stopped at the step limit", time.perf_counter(), 0
        try:
            for step in range(options.steps + 1):
                if step % _REVIEW == 0 or step == options.steps:
                    total = self._review()
                    history.append((step, total))
                    if update is not None:
                        update(step, options.steps, f"loss {total:.4g}")
                    if total < best_loss:
                        best_loss = total
                        best_state = {k: v.clone() for k, v in self.net.state_dict().items()}
                    if callback is not None:
                        callback(step, self.warp())
                    if _has_converged(history, options.tolerance):
                        status = "converged"
                        break
                if step == options.steps:
                    break
                if watch is not None:
                    watch()
                self._step(optimiser)
                schedule.step()
        except KeyboardInterrupt:
            status = "interrupted"
        if best_state is not None:
            self.net.load_state_dict(best_state)
        return self.warp(self._report(status, step, time.perf_counter() - start, history))

    def _rate(self, step: int) -> float:
        warm_up = min(1.0, (step + 1) / 20)
        return warm_up * max(0.5 * (1.0 + math.cos(math.pi * step / self.options.steps)), 1e-3)

    def warp(self, report: SolveReport | None = None) -> Warp:
        """The map that the net is now."""
        with torch.no_grad():
            parts = (self.net.embeddings(), self.net.frames(), self.before, self.after)
            return Warp(*(part.cpu() for part in parts), report=report)

    def _draw(self) -> tuple[Tensor, Tensor]:
        """Interior points of this step and their importance weights, which sum to about one."""
        size = self.options.samples
        # One draw from each of equally likely strata: less noise than independent draws.
        offsets = torch.rand(size, generator=self.generator, dtype=torch.float64)
        level = (torch.arange(size) + offsets) / size
        drawn = torch.searchsorted(self.cumulative, level).clamp_(max=len(self.pool) - 1)
        drawn = drawn.to(self.pool.device)
        return self.pool[drawn], self.importance[drawn]

    def _set_density(self, weights: Tensor) -> None:
        """Draw the pool's points with these probabilities from now on."""
        self.cumulative = weights.cumsum(0)
        importance = 1.0 / (len(self.pool) * self.options.samples * weights)
        self.importance = importance.to(self.pool.device, torch.float32)

    def _loss(self, sample: tuple[Tensor, Tensor]) -> Tensor:
        stack = self.net.stack()
        points, importance = sample
        image, jacobian = evaluate.forward_and_jacobian(stack, torch.cat([points, self.sources]))
        n = len(points)
        options = self.options
        terms = self._terms(
            (elastic_energy(jacobian[:n]) * importance).sum(),
            image[n:],
            jacobian[n:],
            layer_energy(stack) if options.layer_weight else image.new_zeros(()),
        )
        return terms["total"]

    def _terms(
        self, elastic: Tensor, image: Tensor, jacobian: Tensor, layers: Tensor
    ) -> dict[str, Tensor]:
        squared = (image - self.targets).square().sum(-1)
        turned = (jacobian - self.rotations).square().sum((-1, -2))
        options = self.options
        terms = {
            "elastic": elastic,
            "handle": (squared * self.shares).sum(),
            "rotation": (turned * self.shares).sum(),
            "layer": layers,
        }
        total = sum(getattr(options, f"{name}_weight") * term for name, term in terms.items())
        return {**terms, "total": total}

    @torch.no_grad()
    def _measure(self) -> tuple[dict[str, Tensor], Tensor, Tensor, Tensor]:
        """Loss terms over the whole pool; the energies, determinants and handle images."""
        stack = self.net.stack()
        _, jacobian = evaluate.forward_and_jacobian(stack, self.pool)
        image, handle_jacobian = evaluate.forward_and_jacobian(stack, self.sources)
        energy = elastic_energy(jacobian)
        terms = self._terms(energy.mean(), image, handle_jacobian, layer_energy(stack))
        return terms, energy, determinant_3x3(jacobian), image

    def _review(self) -> float:
        terms, energy, _, _ = self._measure()
        # Half of the draws stay uniform, so that no importance weight exceeds two.
        energy = energy.double().cpu()
        share = energy / energy.sum().clamp(min=1e-300)
        self._set_density(0.5 / len(energy) + 0.5 * share)
        return float(terms["total"])

    def _report(
        self, status: str, steps: int, seconds: float, history: list[tuple[int, float]]
    ) -> SolveReport:
        terms, _, determinants, image = self._measure()
        distance = (image - self.targets).double().norm(dim=-1) / self.unit
        handles = {}
        for handle, part in zip(self.handles, self.region_slices, strict=True):
            own = distance[part]
            rms, largest = float(own.square().mean().sqrt()), float(own.max())
            handles[handle.name] = {"rms": rms, "max": largest}
        rms = float(distance.square().mean().sqrt())
        return SolveReport(
            status=status,
            steps=steps,
            seconds=seconds,
            loss={name: float(value) for name, value in terms.items()},
            handle_error=rms,
            handle_error_relative=rms / self.diagonal,
            handles=handles,
            smallest_determinant=float(determinants.min()),
            history=history,
            options=asdict(self.options),
        )


def _has_converged(history: list[tuple[int, float]], tolerance: float) -> bool:
    reviews = 100 // _REVIEW
    if len(history) <= reviews:
        return False
    before, now = history[-1 - reviews][1], min(loss for _, loss in history[-reviews:])
    return now > (1.0 - tolerance) * before
