"""Weights and optimiser state as arrays by name, and back."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from numpy.typing import NDArray as Array
from torch import nn

from twc_env.errors import DataError


def arrays_of(module: nn.Module, prefix: str) -> dict[str, Array]:
    """The weights of a module."""
    return {prefix + name: tensor.detach().numpy() for name, tensor in module.state_dict().items()}


def fill(module: nn.Module, arrays: Mapping[str, Array], path: Path) -> None:
    """Set the weights of a module. Raises DataError if they are those of another one."""
    wanted = module.state_dict()
    missing = [name for name in wanted if name not in arrays]
    unlike = [name for name in wanted if name in arrays and wanted[name].shape != arrays[name].shape]
    if missing or unlike:
        what = f"lacks {missing[0]}" if missing else f"has another shape of {unlike[0]}"
        raise DataError(
            f"{path} does not fit the settings in config.json beside it, or the environment has others: it {what}; "
            "make the environment with these settings, or train anew"
        )
    module.load_state_dict({name: torch.from_numpy(arrays[name].copy()) for name in wanted})


def arrays_of_adam(optimizer: torch.optim.Optimizer, prefix: str) -> dict[str, Array]:
    """The moments that Adam keeps of each parameter."""
    state = optimizer.state_dict()["state"]
    return {f"{prefix}{k}.{key}": tensor.numpy() for k, own in state.items() for key, tensor in own.items()}


def fill_adam(optimizer: torch.optim.Optimizer, arrays: Mapping[str, Array], path: Path) -> None:
    """Set what `arrays_of_adam` gave. Raises DataError if it is that of other parameters."""
    state: dict[int, dict[str, torch.Tensor]] = {}
    whole = optimizer.state_dict()
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    for name, array in arrays.items():
        number, _, key = name.partition(".")
        at = int(number) if number.isdecimal() else len(parameters)
        fits = at < len(parameters) and (key == "step" or tuple(parameters[at].shape) == array.shape)
        if not fits or key not in ("step", "exp_avg", "exp_avg_sq"):
            raise DataError(
                f"{path} does not fit the settings in config.json beside it: {name} is of no use; train anew"
            )
        state.setdefault(at, {})[key] = torch.from_numpy(array.copy()).reshape(() if key == "step" else array.shape)
    optimizer.load_state_dict({**whole, "state": state})
