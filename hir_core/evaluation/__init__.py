"""`hir evaluate`: a finished run against photographs, and against a true mesh, albedo and light where there are any."""

from hir_core.evaluation.evaluation_request import Question
from hir_core.evaluation.view_evaluation import (
    Truth,
    difference_picture,
    evaluate_run,
    masked_pixels,
    split_in_working_frame,
    spread,
)

__all__ = [
    "Question",
    "Truth",
    "difference_picture",
    "evaluate_run",
    "masked_pixels",
    "split_in_working_frame",
    "spread",
]
