"""Names the asset's thumbnail in its information, by UsdMedia's AssetPreviewsAPI."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pxr import Usd

PACKAGED_THUMBNAIL: Final = "thumbnails/thumbnail.png"
"""The picture's path inside a .usdz."""


def add_thumbnail_info(stage: Usd.Stage, path: str) -> None:
    """Sets the default thumbnail of the default prim; `path` is relative to the layer."""
    from pxr import Sdf, UsdMedia

    previews = UsdMedia.AssetPreviewsAPI.Apply(stage.GetDefaultPrim())
    previews.SetDefaultThumbnails(UsdMedia.AssetPreviewsAPI.Thumbnails(defaultImage=Sdf.AssetPath(path)))
