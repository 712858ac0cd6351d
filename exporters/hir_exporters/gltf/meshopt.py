"""EXT_meshopt_compression: buffer views of the mesh as streams of meshoptimizer, by the library meshopt.

Nothing is lost: floats stay floats, and with `quantize` the 16-bit steps are what is compressed. The order of vertices
and triangles is kept, which costs some of the compression and lets a reader compare the file triangle by triangle. A
reader without the extension would find no mesh, so it is required.
"""

from __future__ import annotations

from typing import Any, Final

from numpy.typing import NDArray

from hir_exporters.errors import ExportError

NAME: Final = "EXT_meshopt_compression"


def encoded(rows: NDArray[Any], triangles: bool) -> bytes:
    """The stream of attributes (N, C), whose rows are multiples of four bytes, or of the indices of triangles (3F,)."""
    try:
        import meshopt
    except ImportError:
        raise ExportError("compression 'meshopt' needs meshopt; install it with: pip install 'hir[compress]'") from None
    # Version 0 of both codecs is all that the extension allows.
    stream: bytes = meshopt.encode_gltf_buffer(rows, "TRIANGLES" if triangles else "ATTRIBUTES", version=0)
    return stream
