"""The abstract base class of each kind of component; a class built from its config: `Class(config)`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Camera, Capture, View

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from torch import Tensor

    from hir_core.capture.capture_size import CaptureSize
    from hir_core.plugins.model_spec import ModelSpec
    from hir_core.scene import EnvironmentMap, Material, Mesh, Scene
    from hir_core.scene.silhouette_targets import SilhouetteTargets

    Energy: TypeAlias = Callable[[Scene], Float[Tensor, ""]]


class CaptureReader(ABC):
    """Reads one format of capture and converts its axes to ours."""

    @abstractmethod
    def matches(self, path: Path) -> bool:
        """Cheaply: is `path` a capture of this format?"""

    @abstractmethod
    def splits(self, path: Path) -> list[str]:
        """Names of the splits that the capture holds; a format without splits has only "train"."""

    @abstractmethod
    def read(self, path: Path, split: str = "train") -> Capture:
        """Reads cameras and names of one split; pixels are read later. Malformed files raise `CaptureError`."""


class MaskSource(ABC):
    """Separates the object from its background."""

    @abstractmethod
    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        """One soft mask (H W, 0…1) for each view, None where it has none to offer."""

    def files(self, capture: Capture) -> Sequence[Path]:
        """Files beyond the photographs that masks come from; asked where the trait `reads_files` is declared."""
        return ()


class Initializer(ABC):
    """One link of the chain that finds cameras, points and a first surface."""

    @abstractmethod
    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """What it was given, with what it found; `workspace` is a folder of its own that survives a resume."""

    def files(self, capture: Capture) -> Sequence[Path]:
        """Files beyond the photographs that it reads; asked where the trait `reads_files` is declared."""
        return ()

    def report(self) -> Mapping[str, Any]:
        """What run.json should say of the last `initialize`: which method ran, what it found; JSON, reproducible."""
        return {}


class GeometryRenderer(ABC):
    """Differentiable silhouettes of a mesh."""

    @abstractmethod
    def prepare(self, views: Sequence[View], downsample: int = 1) -> SilhouetteTargets:
        """Targets of those views' masks; a renderer may subclass `SilhouetteTargets` to cache what it needs."""

    @abstractmethod
    def render(self, mesh: Mesh, cameras: Sequence[Camera]) -> Float[Tensor, "B H W"]:
        """Antialiased coverage in 0…1, differentiable in the positions where the trait `differentiable` says so."""

    @abstractmethod
    def overlap(self, mesh: Mesh, targets: SilhouetteTargets) -> tuple[Float[Tensor, " B"], Float[Tensor, " B"]]:
        """For each target: area of the silhouette and of its intersection with the mask, in pixels; differentiable."""

    def memory(self, size: CaptureSize, views_per_step: int) -> int:
        """Bytes that the targets of a capture and a step of some views take, about; by default masks in float32."""
        return 4 * size.pixels + 40 * views_per_step * size.width * size.height


class PreparedReflectance(ABC):
    """A scene's fixed geometry and a capture's cameras, with all that can be computed once."""

    @abstractmethod
    def radiance(
        self, material: Material, environment: EnvironmentMap, pixels: Int[Tensor, "B 3"]
    ) -> Float[Tensor, "B 3"]:
        """Linear radiance through pixels (view, x, y), differentiable in what the renderer's traits name."""


class ReflectanceSolver(PreparedReflectance):
    """A prepared renderer that also fits by a method of its own, which knows more than gradients of `radiance`.

    The core climbs the ladder of models with it; a fit is opaque to the core.
    """

    def keep(self, folder: Path, seconds: float) -> None:
        """Told before the first fit: where, and how often, fits may keep their state, so that a resume repeats none.

        The core asks for the same fits in the same order again; without this they are computed again.
        """

    @abstractmethod
    def fit(
        self, spec: ModelSpec, start: Any, views: Sequence[int], effort: float, report: Callable[[float], None]
    ) -> Any:
        """Fits light and material of a rung to some views, from an earlier fit or None; `effort` 1 is a full fit,
        0 (for rungs that give texels values of their own) leaves the earlier fit as it is.

        `report` is told the share that is done, 0…1. The result never depends on views that are not named.
        """

    @abstractmethod
    def errors(self, fit: Any, views: Sequence[int]) -> NDArray[np.float64]:
        """Mean squared sRGB error over object pixels of each view."""

    @abstractmethod
    def scene(self, fit: Any, views: Sequence[int], report: Callable[[float], None]) -> tuple[Scene, dict[str, Any]]:
        """The scene of a fit with textures at full resolution, solved from the pixels of `views`."""

    def settle(
        self, scene: Scene, traced: PreparedReflectance | None, views: Sequence[int], report: Callable[[float], None]
    ) -> Scene | None:
        """The last `scene` that was made with its albedo solved once more, so that what `traced`, a reference renderer,
        shows of it comes nearest to the pixels of `views`; without one, what this solver shows of it. `report` is told
        the share done. None where a solver cannot, as by default.
        """
        return None


class ReflectanceRenderer(ABC):
    """Shading. Traits: what it is differentiable in (`material`, `environment`, `mesh`), `stochastic`."""

    @abstractmethod
    def prepare(self, scene: Scene, capture: Capture, downsample: int = 1) -> PreparedReflectance:
        """Caches what fixed geometry allows."""

    @abstractmethod
    def render(self, scene: Scene, camera: Camera) -> Float[Tensor, "H W 4"]:
        """Linear premultiplied colour and antialiased coverage."""

    def memory(self, size: CaptureSize) -> int:
        """Bytes that a fit to a capture takes, about; by default the float32 colours and places of all pixels."""
        return 40 * size.pixels

    def smaller(self) -> Mapping[str, Any]:
        """Options under which a fit takes less memory; empty where there are none."""
        return {}


class Regularizer(ABC):
    """A term of a stage's loss, unweighted; the core multiplies it by its weight."""

    @abstractmethod
    def prepare(self, scene: Scene) -> Energy:
        """Caches what is constant in a stage and returns the term as a function of the scene."""
