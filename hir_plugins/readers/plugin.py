"""Descriptors of the built-in readers."""

from __future__ import annotations

from hir_core.plugins import Component, hookimpl

TRANSFORMS_JSON = Component(
    name="transforms_json",
    target="hir_plugins.readers.transforms_json:TransformsJsonReader",
    summary="NeRF-synthetic, nerfstudio and instant-ngp: transforms.json, or one transforms_<split>.json per split.",
    testing="hir_plugins.readers.contract_inputs:transforms_json",
)

COLMAP_MODEL = Component(
    name="colmap_model",
    target="hir_plugins.readers.colmap_model:ColmapModelReader",
    summary="A COLMAP model, text or binary, with its folder of images.",
    testing="hir_plugins.readers.contract_inputs:colmap_model",
)

PHOTOS = Component(
    name="photos",
    target="hir_plugins.readers.photos:PhotosReader",
    summary="A folder of photographs without cameras, with or without masks.",
    traits=frozenset({"without_cameras"}),
    testing="hir_plugins.readers.contract_inputs:photos",
)

IDR_CAMERAS = Component(
    name="idr_cameras",
    target="hir_plugins.readers.idr_cameras:IdrCamerasReader",
    summary="IDR, NeuS and DTU: cameras.npz with folders image and mask.",
    testing="hir_plugins.readers.contract_inputs:idr_cameras",
)

LLFF = Component(
    name="llff",
    target="hir_plugins.readers.llff:LlffReader",
    summary="LLFF: poses_bounds.npy with a folder of images.",
    testing="hir_plugins.readers.contract_inputs:llff",
)

MIDDLEBURY = Component(
    name="middlebury",
    target="hir_plugins.readers.middlebury:MiddleburyReader",
    summary="Middlebury multi-view stereo: *_par.txt beside its images.",
    testing="hir_plugins.readers.contract_inputs:middlebury",
)

BLENDED_MVS = Component(
    name="blended_mvs",
    target="hir_plugins.readers.blended_mvs:BlendedMvsReader",
    summary="BlendedMVS and MVSNet: cams/*_cam.txt with blended_images.",
    testing="hir_plugins.readers.contract_inputs:blended_mvs",
)

METASHAPE = Component(
    name="metashape",
    target="hir_plugins.readers.metashape:MetashapeReader",
    summary="Agisoft Metashape: cameras exported as XML.",
    testing="hir_plugins.readers.contract_inputs:metashape",
)

REALITY_CAPTURE = Component(
    name="reality_capture",
    target="hir_plugins.readers.reality_capture:RealityCaptureReader",
    summary="RealityScan and RealityCapture: XMP sidecars, or the registration as CSV.",
    testing="hir_plugins.readers.contract_inputs:reality_capture",
)

MESHROOM = Component(
    name="meshroom",
    target="hir_plugins.readers.meshroom:MeshroomReader",
    summary="Meshroom (AliceVision): cameras.sfm in JSON.",
    testing="hir_plugins.readers.contract_inputs:meshroom",
)

OPEN_MVG = Component(
    name="open_mvg",
    target="hir_plugins.readers.open_mvg:OpenMvgReader",
    summary="OpenMVG: sfm_data.json with poses.",
    testing="hir_plugins.readers.contract_inputs:open_mvg",
)

BUNDLER = Component(
    name="bundler",
    target="hir_plugins.readers.bundler:BundlerReader",
    summary="Bundler: bundle.out with its list of images.",
    testing="hir_plugins.readers.contract_inputs:bundler",
)

POLYCAM = Component(
    name="polycam",
    target="hir_plugins.readers.polycam:PolycamReader",
    summary="Polycam: the raw data export with its keyframes.",
    testing="hir_plugins.readers.contract_inputs:polycam",
)

RECORD3D = Component(
    name="record3d",
    target="hir_plugins.readers.record3d:Record3DReader",
    summary="Record3D: a .r3d with ARKit's cameras, and depth where lzfse is installed.",
    testing="hir_plugins.readers.contract_inputs:record3d",
)

VIDEO = Component(
    name="video",
    target="hir_plugins.readers.video:VideoReader",
    summary="A video around the object: the sharpest frame of each of 80 equal parts; needs PyAV.",
    traits=frozenset({"without_cameras"}),
    testing="hir_plugins.readers.contract_inputs:video",
)


@hookimpl
def hir_register_capture_readers() -> list[Component]:
    return [
        TRANSFORMS_JSON,
        COLMAP_MODEL,
        METASHAPE,
        REALITY_CAPTURE,
        MESHROOM,
        OPEN_MVG,
        BUNDLER,
        POLYCAM,
        RECORD3D,
        IDR_CAMERAS,
        LLFF,
        MIDDLEBURY,
        BLENDED_MVS,
        PHOTOS,
        VIDEO,
    ]
