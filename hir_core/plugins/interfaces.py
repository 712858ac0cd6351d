"""The abstract base class of each kind of component; a class built from its config: `Class(config)`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Camera, Capture, View

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from torch import Tensor

    from hir_core.capture.capture_size import CaptureSize
    from hir_core.plugins.model_spec import ModelSpec
    from hir_core.scene import EnvironmentMap, Material, Mesh, Scene
    from hir_core.scene.scan import Scan
    from hir_core.scene.silhouette_targets import SilhouetteTargets

    Energy: TypeAlias = Callable[[Scene], Float[Tensor, ""]]


FitT = TypeVar("FitT")
RefinementT = TypeVar("RefinementT")


class CaptureReader(ABC):
    """Reads one format of capture and converts its axes to ours."""

    @abstractmethod
    def matches(self, path: Path) -> bool:
        """Cheaply: is `path` a capture of this format?"""

    @abstractmethod
    def splits(self, path: Path) -> list[str]:
        """Names of the capture's splits; a format without splits has only "train"."""

    @abstractmethod
    def read(self, path: Path, split: str = "train") -> Capture:
        """Reads cameras and names of one split; pixels are read later. Malformed files raise `CaptureError`."""


class MaskSource(ABC):
    """Separates the object from its background."""

    @abstractmethod
    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        """One soft mask (H, W) in 0…1 for each view; None for a view without one."""

    def files(self, capture: Capture) -> Sequence[Path]:
        """Files beyond the photographs that masks come from; called where the trait `reads_files` is declared."""
        return ()


class Initializer(ABC):
    """One link of the chain that finds cameras, points and a first surface."""

    @abstractmethod
    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """Both with what this initializer adds; `workspace` is a folder of its own that survives a resume."""

    def files(self, capture: Capture) -> Sequence[Path]:
        """Files beyond the photographs that it reads; called where the trait `reads_files` is declared."""
        return ()

    def report(self) -> Mapping[str, Any]:
        """Entries for run.json about the last `initialize`: method, results; JSON-compatible and reproducible."""
        return {}

    def scan(self) -> Scan | None:
        """The mesh file whose surface the last `initialize` returned; None for a surface that it made itself.

        The report compares its texture with the result. No fit is given it.
        """
        return None


class GeometryRenderer(ABC):
    """Differentiable silhouettes of a mesh."""

    @abstractmethod
    def prepare(self, views: Sequence[View], downsample: int = 1) -> SilhouetteTargets:
        """Targets of those views' masks; a renderer may subclass `SilhouetteTargets` to cache what it needs."""

    @abstractmethod
    def render(self, mesh: Mesh, cameras: Sequence[Camera]) -> Float[Tensor, "B H W"]:
        """Antialiased coverage in 0…1; differentiable in the positions with the trait `differentiable`."""

    @abstractmethod
    def overlap(self, mesh: Mesh, targets: SilhouetteTargets) -> tuple[Float[Tensor, " B"], Float[Tensor, " B"]]:
        """For each target: area of the silhouette and of its intersection with the mask, in pixels; differentiable.

        It is called by one thread at a time. Gradients of two results may be computed on two threads at the same time.
        """

    def memory(self, size: CaptureSize, views_per_step: int) -> int:
        """Estimate in bytes of a capture's targets and a step of some views; by default masks in float32."""
        return 4 * size.pixels + 40 * views_per_step * size.width * size.height


class PreparedReflectance(ABC):
    """A scene's fixed geometry and a capture's cameras, with everything that is computed once."""

    @abstractmethod
    def radiance(
        self, material: Material, environment: EnvironmentMap, pixels: Int[Tensor, "B 3"]
    ) -> Float[Tensor, "B 3"]:
        """Linear radiance through pixels (view, x, y), differentiable in what the renderer's traits name."""


@dataclass(frozen=True)
class CheckpointLocation:
    """Where one fit stores its result, and its state while it runs."""

    stem: Path
    """Path without suffix, unique to this fit; the solver appends suffixes of its own."""
    seconds: float
    """Interval at which the state should be stored."""

    def part(self, name: str) -> CheckpointLocation:
        """The checkpoint of a fit that this fit runs first."""
        return replace(self, stem=self.stem.with_name(f"{self.stem.name}_{name}"))


@dataclass(frozen=True, eq=False)
class WeightedTerm:
    """A regularizer that a solver minimises together with the error of the pixels."""

    name: str
    weight: float
    """Weight of the term against the mean absolute sRGB error over pixels and channels."""
    traits: frozenset[str]
    """Of the regularizer."""
    prepare: Callable[[Scene], Energy]
    """The term, unweighted, for a scene like those that it will see: with maps where theirs are maps."""


@dataclass(frozen=True, eq=False)
class Solved(Generic[RefinementT]):
    """The scene of a fit, and what the steps after the fit need."""

    scene: Scene
    prepared: PreparedReflectance
    """Shades `scene` with all that the fit modelled, its indirect light included, for gradient steps."""
    refinement: RefinementT
    """What `ReflectanceSolver.refine` needs; opaque to the core."""
    report: Mapping[str, Any]
    """JSON-compatible figures for run.json, where they stand under `solver`."""
    exposures: Float[Tensor, "views 3"] | None = None
    """Factors of brightness and white balance of each photograph that the fit used, beside `View.gain`; None for 1."""


class ReflectanceSolver(PreparedReflectance, Generic[FitT, RefinementT]):
    """A prepared renderer that also fits by a method of its own, which knows more than gradients of `radiance`.

    The core selects the model with it. `FitT` and `RefinementT` are opaque to the core. A result depends on the
    arguments of its call alone, never on which call came before; a solver may cache what it would compute again.
    """

    concurrent_fits: ClassVar[bool] = False
    """Whether `fit` and `errors` may run on several threads at the same time."""

    def with_terms(self, terms: Sequence[WeightedTerm]) -> ReflectanceSolver[FitT, RefinementT]:
        """The same solver with regularizers: every fit, scene and refinement of it minimises them too.

        Called where the renderer declares the trait `regularizers`; otherwise gradient steps with the terms follow the
        solver.
        """
        raise TypeError(f"{type(self).__name__} declares the trait 'regularizers' and has no method with_terms")

    def supported(self, spec: ModelSpec) -> ModelSpec | None:
        """The model nearest to `spec`, of the same kind of material and frame of the light, that this solver fits.

        None where it fits no such kind or frame. By default it fits every model. The model selection compares no model
        that differs from its `supported` one.
        """
        return spec

    def simpler(self, spec: ModelSpec) -> ModelSpec | None:
        """The model that `fit` without an initial fit fits first, with the same effort; None, the default, for none.

        The model selection compares models after equal numbers of steps, and counts these.
        """
        return None

    @abstractmethod
    def fit(
        self,
        spec: ModelSpec,
        initial: FitT | None,
        views: Sequence[int],
        effort: float,
        report: Callable[[float], None],
        checkpoint: CheckpointLocation | None = None,
        pixel_share: float = 1.0,
    ) -> FitT:
        """Fits light and material of a model to some views, from an earlier fit or from its own initial guess.

        `effort` 1 is a full fit, of its steps; 0 (for models with `per_texel` values, and to compare a fit at fitted
        exposures) leaves the parameters at vertices as they are. `pixel_share` is the share of the pixels of a full
        fit, 0…1, that are used. `report` receives the share that is done, 0…1. With a `checkpoint` a finished fit is
        read again instead of computed, and an interrupted one continues from its last state. The result does not depend
        on other views.
        """

    @abstractmethod
    def errors(self, fit: FitT, views: Sequence[int]) -> NDArray[np.float64]:
        """Mean squared sRGB error over object pixels of each view.

        Where the exposures of the model are fitted a view that the fit did not use has none: it is compared at those
        that suit it best.
        """

    def errors_between_lights(self, fit: FitT, views: Sequence[int]) -> NDArray[np.float64] | None:
        """`errors` for comparisons of models whose lights differ in kind; None, the default, where they are the same.

        A light that moves with the camera imitates what depends on the angle of view alone. A solver whose models lack
        such a property of surfaces, as their brightening towards grazing angles, leaves it out of these errors.
        """
        return None

    def exposures(self, fit: FitT, views: Sequence[int]) -> NDArray[np.float64] | None:
        """Factors (views, 3) of brightness and white balance of photographs that a fit used; None where it fitted none,
        or, the default, where the solver does not tell them.

        The model selection rejects fitted exposures that hardly differ.
        """
        return None

    @abstractmethod
    def scene(self, fit: FitT, views: Sequence[int], report: Callable[[float], None]) -> Solved[RefinementT]:
        """The scene of a fit with textures at full resolution, solved from the pixels of `views`."""

    def refine(
        self,
        solved: Solved[RefinementT],
        traced: PreparedReflectance | None,
        views: Sequence[int],
        report: Callable[[float], None],
    ) -> Solved[RefinementT] | None:
        """The scene with its diffuse albedo solved again, so that the radiance of `traced`, a reference renderer, comes
        nearest to the pixels of `views`; without `traced`, the radiance of this solver. None where a solver cannot, as
        by default.
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
        """Estimate in bytes of a fit to a capture; by default the float32 colours and positions of all pixels."""
        return 40 * size.pixels

    def smaller(self) -> Mapping[str, Any]:
        """Options with which a fit takes less memory; empty where there are none."""
        return {}


class Regularizer(ABC):
    """A term of a stage's loss, unweighted; the core multiplies it by its weight."""

    @abstractmethod
    def prepare(self, scene: Scene) -> Energy:
        """Caches what is constant in a stage and returns the term as a function of the scene."""
