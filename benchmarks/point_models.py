"""What each part of a reflectance model gains at single surface points, without textures or visibility.

Points of `benchmarks.observed_points` are fitted to the train photographs by Adam, each with
parameters of its own, under one light that is filtered to the width of the lobe (GGX seen along its normal) with Karis'
fit of the lobe's albedo. The unseen views evaluate them. This is a practical bound, not a theoretical one: a point has
some twenty photographs for up to twelve parameters. The error on the training photographs is printed, too.

    python -m benchmarks.point_models CAPTURE RUN
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from hir_exporters.conventions import srgb_to_linear
from torch import Tensor

from benchmarks.observed_points import ObservedPoints, decibels, observed_points
from hir_core.plugins.manager import PluginManager
from hir_core.scene.srgb import linear_to_srgb

ROWS, COLUMNS = 24, 48
"""Of the light."""
WIDTHS = torch.tensor([0.05, 0.1, 0.2, 0.35, 0.55, 0.8, 1.0])
STEPS, BATCH, MIN_OBSERVATIONS = 500, 60_000, 4
NORMAL_OFFSET_SCALE = 0.5
CLIPPED_SRGB = 0.99
VELVET_KNOTS = 9
"""Of the velvet's dependence on the angle of view."""
RESPONSE_KNOTS, FIRST_KNOT_LOG2 = 17, -10
"""Knots of the response curve, one per doubling of radiance, and log2 of the radiance of the first one."""


@dataclass(frozen=True)
class ModelParts:
    """Which parameters each point has besides the albedo, and whether a response curve is fitted."""

    lobe: bool = False
    """F0 in colour, and α."""
    normals: bool = False
    velvet: bool = False
    """A second diffuse colour, weighted by one function of the view angle that all points share."""
    response: bool = False
    """From radiance to the photographs' values, monotonic, in position of sRGB's curve."""


MODELS = {
    "diffuse": ModelParts(),
    "diffuse, and a response curve": ModelParts(response=True),
    "F0 and α of each point": ModelParts(lobe=True),
    "F0, α and normal of each point": ModelParts(lobe=True, normals=True),
    "and also a response curve": ModelParts(lobe=True, normals=True, response=True),
    "and also velvet, with sRGB's curve": ModelParts(lobe=True, normals=True, velvet=True),
}


class PointModel(torch.nn.Module):
    """Values at N points, the light and the response."""

    def __init__(self, points: ObservedPoints, parts: ModelParts) -> None:
        super().__init__()
        observed = torch.from_numpy(points.observed)[..., None]
        mean = ((torch.from_numpy(points.colors) * observed).sum(1) / observed.sum(1)).float().clamp(0.02, 0.95)
        self.normals = torch.from_numpy(points.normals).float()
        self.diffuse = torch.nn.Parameter(torch.logit(0.7 * mean))
        self.specular = torch.nn.Parameter(torch.logit((0.5 * mean).clamp_min(0.02)), parts.lobe)
        self.width = torch.nn.Parameter(torch.zeros(len(mean)), parts.lobe)
        self.normal_offset = torch.nn.Parameter(torch.zeros(len(mean), 3), parts.normals)
        self.velvet = torch.nn.Parameter(torch.full((len(mean), 3), -3.6), parts.velvet)
        self.grazing = torch.nn.Parameter(torch.linspace(0.5, -0.5, VELVET_KNOTS), parts.velvet)
        self.response = torch.nn.Parameter(torch.zeros(RESPONSE_KNOTS), parts.response)
        self.light = torch.nn.Parameter(torch.zeros(ROWS * COLUMNS, 3))
        self.parts = parts
        theta = (torch.arange(ROWS) + 0.5) / ROWS * np.pi
        phi = (torch.arange(COLUMNS) + 0.5) / COLUMNS * 2 * np.pi
        t, p = (x.reshape(-1) for x in torch.meshgrid(theta, phi, indexing="ij"))
        unit_directions = torch.stack([t.sin() * p.cos(), t.sin() * p.sin(), t.cos()], dim=1)
        cosine, area = unit_directions @ unit_directions.T, t.sin() * (np.pi / ROWS) * (2 * np.pi / COLUMNS)
        half = ((1 + cosine) / 2).clamp_min(0)
        square = WIDTHS[:, None, None] ** 2
        lobes = square / (half * (square - 1) + 1) ** 2 * cosine.clamp_min(0) * area
        self.lobes = lobes / lobes.sum(dim=2, keepdim=True)
        self.cosines = cosine.clamp_min(0) * area / np.pi

    def forward(self, which: Tensor, toward: Tensor) -> Tensor:
        """Radiance (M, 3) of points `which` (M,) in directions (M, 3)."""
        normal = torch.nn.functional.normalize(
            self.normals[which] + NORMAL_OFFSET_SCALE * self.normal_offset[which], dim=1
        )
        light = self.light.exp()
        diffuse = torch.sigmoid(self.diffuse[which]) * lookup_latlong(self.cosines @ light, normal)
        if self.parts.velvet:
            share = interpolate_knots(self.grazing.exp(), (normal * toward).sum(dim=1).clamp(0, 1) * (VELVET_KNOTS - 1))
            diffuse = diffuse + self.velvet[which].exp() * share[:, None] * lookup_latlong(self.cosines @ light, normal)
        if not self.parts.lobe:
            return diffuse
        f0, width = torch.sigmoid(self.specular[which]), 0.03 + 0.97 * torch.sigmoid(self.width[which])
        cosine = (normal * toward).sum(dim=1)
        mirrored = 2 * cosine[:, None] * normal - toward
        filtered = torch.einsum("kij,jc->kic", self.lobes, light).reshape(-1, 3)
        levels = WIDTHS.log()
        level = (torch.bucketize(width.detach().log(), levels) - 1).clamp(0, len(WIDTHS) - 2)
        share = ((width.log() - levels[level]) / (levels[level + 1] - levels[level])).clamp(0, 1)[:, None]
        low, high = (lookup_latlong(filtered, mirrored, (level + i) * ROWS * COLUMNS) for i in (0, 1))
        scale, bias = lobe_albedo(width, cosine.clamp(0.02, 1))
        reflected = (low * (1 - share) + high * share) * (f0 * scale[:, None] + bias[:, None])
        return diffuse * (1 - f0) + reflected

    def shown(self, radiance: Tensor) -> Tensor:
        """Photograph values (sRGB) of radiance, both (M, 3)."""
        if not self.parts.response:
            return linear_to_srgb(radiance)
        exposures = torch.exp2(torch.arange(RESPONSE_KNOTS) + float(FIRST_KNOT_LOG2)).clamp(max=1)
        rises = linear_to_srgb(exposures).diff(prepend=torch.zeros(1)).clamp_min(2e-3)
        curve = (rises * self.response.exp()).cumsum(dim=0)
        return interpolate_knots(curve, torch.log2(radiance.clamp_min(1e-4)) - FIRST_KNOT_LOG2)


def interpolate_knots(values: Tensor, position: Tensor) -> Tensor:
    """Linear interpolation between K values, at places of any shape from 0 to K - 1."""
    position = position.clamp(0, len(values) - 1)
    knot = position.detach().floor().long().clamp(max=len(values) - 2)
    return values[knot] * (1 - position + knot) + values[knot + 1] * (position - knot)


def lookup_latlong(image: Tensor, direction: Tensor, first: Tensor | int = 0) -> Tensor:
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
    """Factor of F0 and the added bias (Karis 2014), of α and the cosine of the view."""
    r = width.sqrt()[:, None] * torch.tensor([-1, -0.0275, -0.572, 0.022]) + torch.tensor([1, 0.0425, 1.04, -0.04])
    a = torch.minimum(r[:, 0] ** 2, torch.exp2(-9.28 * cosine)) * r[:, 0] + r[:, 1]
    return -1.04 * a + r[:, 2], 1.04 * a + r[:, 3]


def fit_points(points: ObservedPoints, parts: ModelParts) -> tuple[np.ndarray, float]:
    """Predicted sRGB (N, 3) in the unseen views, and PSNR in dB on the training photographs."""
    torch.manual_seed(0)
    model = PointModel(points, parts)
    which = torch.from_numpy(np.nonzero(points.observed)[0])
    photographs = linear_to_srgb(torch.from_numpy(points.colors[points.observed]).float())
    toward = torch.from_numpy(points.directions[points.observed]).float()
    free_parameters = [p for p in model.parameters() if p.requires_grad]
    rates = {id(model.light): 0.03, id(model.response): 0.02}
    optimizer = torch.optim.Adam([{"params": [p], "lr": rates.get(id(p), 0.05)} for p in free_parameters])
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, STEPS, 1e-3)
    for _ in range(STEPS):
        batch = torch.randint(len(which), (BATCH,))
        off = model.shown(model(which[batch], toward[batch])) - photographs[batch]
        off = torch.where((photographs[batch] > CLIPPED_SRGB) & (off > 0), torch.zeros_like(off), off)
        image = model.light.view(ROWS, COLUMNS, 3)
        rough = image.diff(dim=0).abs().mean() + image.diff(dim=1).abs().mean()
        optimizer.zero_grad()
        (off.abs().mean() + 0.002 * rough).backward()
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        some = torch.randperm(len(which))[: 4 * BATCH]
        off = model.shown(model(which[some], toward[some])).clamp(0, 1) - photographs[some]
        unseen = model.shown(model(torch.arange(len(points.color)), torch.from_numpy(points.direction).float()))
        if parts.velvet:
            print("  velvet from the horizon to facing:", [round(v, 2) for v in model.grazing.exp().tolist()])
        if parts.response:
            radiance = torch.tensor([0.01, 0.05, 0.2, 0.5, 0.9])
            for name, shown in (("response", model.shown(radiance)), ("sRGB", linear_to_srgb(radiance))):
                print(f"  {name} of {radiance.tolist()}:", [round(v, 2) for v in shown.tolist()])
        return unseen.numpy(), float(-10 * torch.log10(off.square().mean()))


def main() -> None:
    capture, run = map(Path, sys.argv[1:3])
    all_points = observed_points(capture, run, PluginManager.discover())
    enough = all_points.observed.sum(axis=1) >= MIN_OBSERVATIONS
    points = ObservedPoints(*(getattr(all_points, name)[enough] for name in ObservedPoints.__dataclass_fields__))
    for name, parts in MODELS.items():
        unseen, training = fit_points(points, parts)
        print(f"{name}: {decibels(points, srgb_to_linear(unseen)):.2f} dB; photographs {training:.2f} dB", flush=True)


if __name__ == "__main__":
    main()
