"""The quick run of the pipeline's tests, for tests that count what a run does."""

from tests.pipeline.conftest import quick

__all__ = ["quick"]
