"""This project's own method, as one of the comparison."""

from __future__ import annotations

import time

import implicit_warp as iw
from experiments.baselines.method import Body, Fitted


def fit_tuttenet(source, target, faces, *, height, seconds, seed=0, **options) -> Fitted:
    """`implicit_warp.fit` with its default number of steps, if these end in time.

    Other options go to `fit`.
    """
    trace, start = [], time.process_time()
    clock: list[float] = []
    warp = iw.fit(
        Body(source, faces), Body(target, faces), height=height, seed=seed,
        callback=lambda step, warp: clock.append(time.process_time() - start),
        **{"seconds": seconds, **options},
    )  # fmt: skip
    report = warp.report
    for cpu, (_, _, _, vertex, gradient) in zip(clock, report.history, strict=False):
        trace.append((cpu, vertex, gradient))
    trace.append((time.process_time() - start, report.vertex_error, report.gradient_error))
    net = iw.TutteNet(
        report.options["layers"], report.options["resolution"], report.options["frames"],
        report.options["boundary"],
    )  # fmt: skip
    parameters = sum(p.numel() for p in net.parameters())
    return Fitted(warp(source), warp, parameters, report.steps, trace)
