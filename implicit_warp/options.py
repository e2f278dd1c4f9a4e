"""What the options of all solves share: how they are checked, and changed by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, Self

import torch

from implicit_warp.errors import InputError


class Options:
    """Base of frozen dataclasses of options; each calls the checks it needs when it is made."""

    def with_changes(self, values: Mapping[str, Any]) -> Self:
        """A copy with some options replaced.

        Raises:
            InputError: an unknown name, or a value out of range.
        """
        known = [option.name for option in fields(self)]
        for name in values:
            if name not in known:
                raise InputError(
                    name, values[name], "no such option of the solve", f"use {', '.join(known)}"
                )
        return replace(self, **values)

    def _refuse(self, name: str, cause: str, remedy: str = "") -> None:
        raise InputError(name, getattr(self, name), cause, remedy or f"see {type(self).__name__}")

    def _check_counts(self, *names: str) -> None:
        for name in names:
            value = getattr(self, name)
            if type(value) is not int or value < 1:
                self._refuse(name, "not a positive whole number")

    def _check_numbers(self, *names: str, positive: bool = False) -> None:
        for name in names:
            value = getattr(self, name)
            good = isinstance(value, int | float) and not isinstance(value, bool)
            if not good or not 0 <= value < math.inf:
                self._refuse(name, "not a number >= 0")
            if positive and value == 0:
                self._refuse(name, "not a positive number")

    def _check_choice(self, name: str, known: tuple[str, ...]) -> None:
        if getattr(self, name) not in known:
            self._refuse(name, "no such choice", f"use one of {', '.join(known)}")

    def _check_seed(self, seed: int) -> None:
        if type(seed) is not int or not 0 <= seed < 2**63:
            self._refuse("seed", "not a whole number in [0, 2^63)", "pass e.g. 0")

    def _check_device(self, device: str) -> None:
        try:
            torch.empty(0, device=device)
        except (RuntimeError, AssertionError, TypeError) as error:
            cause = str(error).splitlines()[0]
            raise InputError(
                "device", device, f"torch cannot use it ({cause})", 'use "cpu"'
            ) from error
