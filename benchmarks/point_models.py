"""What each part of a model of reflection is worth at single points of a mesh, without textures or visibility.

Points of `benchmarks.seen_points` are fitted to the train photographs by Adam, each with values of its own, under one
light that is filtered to the lobe's width (GGX seen along its normal) with Karis' fit of the lobe's albedo; the unseen
views judge. A bound in practice, not in theory: a point has some twenty photographs for up to nine numbers.

    python -m benchmarks.point_models CAPTURE RUN
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.seen_points import SeenPoints, decibels, seen_points
from hir_core.manager import PluginManager
from hir_core.srgb import linear_to_srgb

ROWS, COLUMNS = 24, 48
"""Of the light."""
WIDTHS = torch.tensor([0.05, 0.1, 0.2, 0.35, 0.55, 0.8, 1.0])
STEPS, BATCH, FEWEST = 500, 60_000, 4
TILT = 0.5
SATURATED = 0.99
MODELS = {"diffuse": (False, False), "F0 and α of each point": (True, False), "and its own normal": (True, True)}


class PointModel(torch.nn.Module):
    """Values at N points and the light."""

    def __init__(self, points: SeenPoints, lobe: bool, normals: bool) -> None:
        super().__init__()
        seen = torch.from_numpy(points.seen)[..., None]
        mean = ((torch.from_numpy(points.colors) * seen).sum(1) / seen.sum(1)).float().clamp(0.02, 0.95)
        self.normals = torch.from_numpy(points.normals).float()
        self.diffuse = torch.nn.Parameter(torch.logit(0.7 * mean))
        self.specular = torch.nn.Parameter(torch.logit((0.5 * mean).clamp_min(0.02)), lobe)
        self.width = torch.nn.Parameter(torch.zeros(len(mean)), lobe)
        self.tilt = torch.nn.Parameter(torch.zeros(len(mean), 3), normals)
        self.light = torch.nn.Parameter(torch.zeros(ROWS * COLUMNS, 3))
        self.lobe = lobe
        theta = (torch.arange(ROWS) + 0.5) / ROWS * np.pi
        phi = (torch.arange(COLUMNS) + 0.5) / COLUMNS * 2 * np.pi
        t, p = (x.reshape(-1) for x in torch.meshgrid(theta, phi, indexing="ij"))
        places = torch.stack([t.sin() * p.cos(), t.sin() * p.sin(), t.cos()], dim=1)
        cosine, area = places @ places.T, t.sin() * (np.pi / ROWS) * (2 * np.pi / COLUMNS)
        half = ((1 + cosine) / 2).clamp_min(0)
        square = WIDTHS[:, None, None] ** 2
        lobes = square / (half * (square - 1) + 1) ** 2 * cosine.clamp_min(0) * area
        self.lobes = lobes / lobes.sum(dim=2, keepdim=True)
        self.cosines = cosine.clamp_min(0) * area / np.pi

    def forward(self, which: Tensor, toward: Tensor) -> Tensor:
        """Radiance (M, 3) of points `which` (M,) in directions (M, 3)."""
        normal = torch.nn.functional.normalize(self.normals[which] + TILT * self.tilt[which], dim=1)
        light = self.light.exp()
        diffuse = torch.sigmoid(self.diffuse[which]) * looked_up(self.cosines @ light, normal)
        if not self.lobe:
            return diffuse
        f0, width = torch.sigmoid(self.specular[which]), 0.03 + 0.97 * torch.sigmoid(self.width[which])
        cosine = (normal * toward).sum(dim=1)
        mirrored = 2 * cosine[:, None] * normal - toward
        filtered = torch.einsum("kij,jc->kic", self.lobes, light).reshape(-1, 3)
        levels = WIDTHS.log()
        level = (torch.bucketize(width.detach().log(), levels) - 1).clamp(0, len(WIDTHS) - 2)
        share = ((width.log() - levels[level]) / (levels[level + 1] - levels[level])).clamp(0, 1)[:, None]
        low, high = (looked_up(filtered, mirrored, (level + i) * ROWS * COLUMNS) for i in (0, 1))
        scale, bias = lobe_albedo(width, cosine.clamp(0.02, 1))
        reflected = (low * (1 - share) + high * share) * (f0 * scale[:, None] + bias[:, None])
        return diffuse * (1 - f0) + reflected


def looked_up(image: Tensor, direction: Tensor, first: Tensor | int = 0) -> Tensor:
    """Lat-long values (…, 3), rows one after the other from `first` on, in directions (M, 3), bilinear."""
    theta = torch.acos(direction[:, 2].clamp(-0.9999, 0.9999))
    phi = torch.atan2(direction[:, 1], direction[:, 0]) % (2 * np.pi)
    y = (theta / np.pi * ROWS - 0.5).clamp(0, ROWS - 1.001)
    x = phi / (2 * np.pi) * COLUMNS - 0.5
    row, column = y.detach().floor().long(), x.detach().floor().long()
    down, across = (y - row)[:, None], (x - column)[:, None]

    def at(i: int, j: int) -> Tensor:
        return image[first + (row + i) * COLUMNS + (column + j) % COLUMNS]

    upper, lower = (at(i, 0) * (1 - across) + at(i, 1) * across for i in (0, 1))
    return upper * (1 - down) + lower * down


def lobe_albedo(width: Tensor, cosine: Tensor) -> tuple[Tensor, Tensor]:
    """Factor of F0 and what is added to it (Karis 2014), of α and the cosine of the view."""
    r = width.sqrt()[:, None] * torch.tensor([-1, -0.0275, -0.572, 0.022]) + torch.tensor([1, 0.0425, 1.04, -0.04])
    a = torch.minimum(r[:, 0] ** 2, torch.exp2(-9.28 * cosine)) * r[:, 0] + r[:, 1]
    return -1.04 * a + r[:, 2], 1.04 * a + r[:, 3]


def fitted(points: SeenPoints, lobe: bool, normals: bool) -> np.ndarray:
    """Colours (N, 3) that unseen views would show."""
    torch.manual_seed(0)
    model = PointModel(points, lobe, normals)
    which = torch.from_numpy(np.nonzero(points.seen)[0])
    colors = torch.from_numpy(points.colors[points.seen]).float()
    toward = torch.from_numpy(points.directions[points.seen]).float()
    wanted = [p for p in model.parameters() if p.requires_grad]
    optimizer = torch.optim.Adam([{"params": [p], "lr": 0.03 if p is model.light else 0.05} for p in wanted])
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, STEPS, 1e-3)
    for _ in range(STEPS):
        batch = torch.randint(len(which), (BATCH,))
        off = linear_to_srgb(model(which[batch], toward[batch])) - linear_to_srgb(colors[batch])
        off = torch.where((colors[batch] > SATURATED) & (off > 0), torch.zeros_like(off), off)
        image = model.light.view(ROWS, COLUMNS, 3)
        rough = image.diff(dim=0).abs().mean() + image.diff(dim=1).abs().mean()
        optimizer.zero_grad()
        (off.abs().mean() + 0.002 * rough).backward()
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        return model(torch.arange(len(points.color)), torch.from_numpy(points.direction).float()).numpy()


def main() -> None:
    capture, run = map(Path, sys.argv[1:3])
    found = seen_points(capture, run, PluginManager.discover())
    enough = found.seen.sum(axis=1) >= FEWEST
    points = SeenPoints(*(getattr(found, name)[enough] for name in SeenPoints.__dataclass_fields__))
    for name, (lobe, normals) in MODELS.items():
        print(f"{name}: {decibels(points, fitted(points, lobe, normals)):.2f} dB", flush=True)


if __name__ == "__main__":
    main()
