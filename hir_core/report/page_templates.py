"""HTML and SVG of the report by Jinja2. Every value is escaped; only the output of a template counts as markup."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup


def render(template: str, **values: object) -> Markup:
    """The output of a file in `template/`; a name that the template uses and `values` lack is an error."""
    return Markup(_environment().get_template(template).render(values))


def read_asset(name: str) -> Markup:
    """A style sheet or script in `template/`, which are part of the program and so need no escaping."""
    return Markup(_source(name))


@cache
def _environment() -> Environment:
    return Environment(
        loader=FunctionLoader(_source),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def _source(name: str) -> str:
    return (files("hir_core.report") / "template" / name).read_text(encoding="utf-8")
