"""The small run of the pipeline's tests."""

from tests.pipeline.conftest import finished, quick, tiny_capture

__all__ = ["finished", "quick", "tiny_capture"]
