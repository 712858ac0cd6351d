"""Large steps on meshes (Nicolet, Jacobson, Jakob 2021): Adam moves `u = (I + λL) x`, which smooths the steps of x."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.scene import Topology


class LargeSteps:
    """The preconditioner of one topology; `L` is the combinatorial Laplacian.

    The matrix is factorised once; each step takes two solves.
    """

    def __init__(self, topology: Topology, vertices: int, smoothness: float) -> None:
        import cholespy

        edges = topology.edges.cpu().numpy()
        degree = np.bincount(edges.reshape(-1), minlength=vertices)
        diagonal = np.arange(vertices)
        rows = np.concatenate([diagonal, edges[:, 0], edges[:, 1]])
        columns = np.concatenate([diagonal, edges[:, 1], edges[:, 0]])
        values = np.concatenate([1 + smoothness * degree, np.full(2 * len(edges), -smoothness)])
        device = topology.faces.device
        self._edges = topology.edges
        self._smoothness = smoothness
        self._solver = cholespy.CholeskySolverF(
            vertices,
            torch.from_numpy(rows).int().to(device),
            torch.from_numpy(columns).int().to(device),
            torch.from_numpy(values).double().to(device),
            cholespy.MatrixType.COO,
        )

    def encode(self, positions: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
        """`u` of positions."""
        a, b = self._edges.unbind(1)
        pull = self._smoothness * (positions[a] - positions[b])
        return positions.index_add(0, a, pull).index_add(0, b, -pull)

    def decode(self, u: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
        """Positions of `u`; differentiable. The matrix is its own transpose: the gradient is one more solve."""
        return _Solve.apply(u, self.solve)  # type: ignore[no-any-return,no-untyped-call]

    def solve(self, right: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
        """`(I + λL)⁻¹ right`, without gradient."""
        right = right.detach().contiguous()
        solution = torch.empty_like(right)
        self._solver.solve(right, solution)
        return solution


class _Solve(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, u: Tensor, solve: Callable[[Tensor], Tensor]) -> Tensor:
        ctx.solve = solve
        return solve(u)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:  # type: ignore[override]
        return ctx.solve(gradient), None


class UniformAdam(torch.optim.Optimizer):
    """Adam with one second moment for the whole tensor (Nicolet et al. 2021, section 4), which keeps the direction of a
    step.
    """

    def __init__(self, parameters: Iterable[Tensor], lr: float, betas: tuple[float, float] = (0.9, 0.999)) -> None:
        super().__init__(parameters, {"lr": lr, "betas": betas})

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """One step; parameters with a zero gradient stay."""
        for group in self.param_groups:
            beta1, beta2 = group["betas"]
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                state = self.state[parameter]
                if not state:
                    state["step"] = torch.zeros(())
                    state["first"] = torch.zeros_like(parameter)
                    # in float64: squares of a tiny gradient underflow in float32, and the step would be huge
                    state["second"] = torch.zeros_like(parameter, dtype=torch.float64)
                state["step"] += 1
                count = float(state["step"])
                state["first"].lerp_(parameter.grad, 1 - beta1)
                square = parameter.grad.double().square()
                state["second"].mul_(beta2).add_(square, alpha=1 - beta2)
                first = state["first"] / (1 - beta1**count)
                largest = state["second"].max() / (1 - beta2**count)
                # no epsilon, which could exceed the gradients of a large mesh; the clamp keeps a zero gradient at zero
                size = largest.sqrt().to(first.dtype).clamp_min(torch.finfo(first.dtype).tiny)
                parameter -= group["lr"] * (first / size)
