"""The one place that makes pages: one environment, one style sheet, one base that every template extends."""

from __future__ import annotations

from functools import cache
from importlib import resources

from jinja2 import Environment, FunctionLoader, StrictUndefined

from thetacomp import __version__
from thetacomp.report import tables


def page(template: str, **facts: object) -> str:
    """The HTML of `package/file`, the file lying in the folder `templates` of that package.

    Every text is escaped, and a fact that a template asks for and does not get is an error.
    """
    return _environment().get_template(template).render(version=__version__, **facts)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FunctionLoader(_source),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=tables.number, significant=tables.significant, sentence=tables.sentence)
    return environment


def _source(name: str) -> str:
    package, _, file = name.rpartition("/")
    return resources.files(package).joinpath("templates", file).read_text(encoding="utf-8")
