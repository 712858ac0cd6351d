"""The up direction of a world whose files do not define it, from the orientation of the cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hir_core.capture import Array, View


def upright_rotation_of(views: Sequence[View]) -> Array:
    """`upright_rotation` of the views with cameras, of the first take that has any.

    In another take the object may lie on another side, and cameras in its axes have another up direction.
    """
    posed = [(view.take, view.camera.world_to_camera) for view in views if view.camera is not None]
    return upright_rotation([pose for take, pose in posed if take == posed[0][0]])


def upright_rotation(world_to_cameras: Sequence[Array]) -> Array:
    """Rotation 4×4 from the files' world to one in which the cameras' common up direction is +Y.

    People hold cameras level, so up is the direction most nearly perpendicular to the images' horizontal axes. It must
    agree with the mean up axis of the cameras within 45°; otherwise that mean is used. For cameras without a common up
    direction it is the first camera's.
    """
    rights = np.array([pose[0, :3] for pose in world_to_cameras])
    ups = np.array([-pose[1, :3] for pose in world_to_cameras])
    mean = ups.mean(axis=0)
    strength = float(np.linalg.norm(mean))
    up = mean / strength if strength > 0.2 else ups[0] / np.linalg.norm(ups[0])
    values, vectors = np.linalg.eigh(rights.T @ rights / len(rights))
    candidate = vectors[:, 0] * np.sign(vectors[:, 0] @ up or 1.0)
    # the horizontal axes must span a plane; otherwise the perpendicular direction is ambiguous
    if strength > 0.2 and candidate @ up > np.sqrt(0.5) and values[1] > 4 * values[0] + 1e-6:
        up = candidate
    backward = -world_to_cameras[0][2, :3]
    # the first camera looks along -Z, projected onto the horizontal plane
    z = backward - (backward @ up) * up
    if np.linalg.norm(z) < 1e-6:
        z = np.cross(rights[0], up)
    z = z / np.linalg.norm(z)
    rotation = np.eye(4)
    rotation[:3, :3] = np.stack([np.cross(up, z), up, z])
    return rotation
