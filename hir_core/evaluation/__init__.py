"""`hir evaluate`: measures a finished run against photographs, and against the true mesh, albedo and light if known."""

from hir_core.evaluation.evaluation_request import EvaluationRequest
from hir_core.evaluation.view_evaluation import evaluate_run

__all__ = ["EvaluationRequest", "evaluate_run"]
