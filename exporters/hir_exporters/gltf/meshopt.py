"""EXT_meshopt_compression: buffer views of the mesh as meshoptimizer streams, encoded by the library meshopt.

The compression is lossless, of floats and of the 16-bit integers of `quantize`. The order of vertices and triangles is
preserved: the file is somewhat larger, and verification can compare it triangle by triangle. The extension is required,
because a reader without it finds no mesh.
"""

from __future__ import annotations

from typing import Any, Final

from numpy.typing import NDArray

from hir_exporters.errors import ExportError

NAME: Final = "EXT_meshopt_compression"


def encoded(rows: NDArray[Any], triangles: bool) -> bytes:
    """The stream of attributes (N, C), whose rows are multiples of four bytes, or of triangle indices (3F,)."""
    try:
        import meshopt
    except ImportError:
        raise ExportError("compression 'meshopt' needs meshopt; install it with: pip install 'hir[compress]'") from None
    # The extension allows only version 0 of both codecs.
    stream: bytes = meshopt.encode_gltf_buffer(rows, "TRIANGLES" if triangles else "ATTRIBUTES", version=0)
    return stream
