"""The types of a comparison, which the HTTP API does not have."""

from __future__ import annotations

from typing import TypedDict

from . import shapes


class InsideAgreement(TypedDict):
    """Whether both models enclose the same points."""

    points: int
    """Number of points evaluated."""
    agree_pct: float
    """Share of the points on which both models agree, in percent."""
    overlap_pct: float | None
    """Of the points inside at least one model, the share inside both, in percent."""
    inside_before: int
    """Number of points inside the first model."""
    inside_after: int
    """Number of points inside the second model."""


class ComparedModel(TypedDict):
    """One of the compared models."""

    format: shapes.Format
    dialect: str
    measures: shapes.Measures
    warnings: list[str]


class ComparisonFigures(shapes.Changes):
    """How the second model differs from the first."""

    version: int
    faithful: bool
    """Whether the second model keeps the first's shape."""
    visible_pct: float | None
    """Share of the first model's surface that is visible from outside, in percent."""
    deviation: shapes.Deviation | None
    """Distance from the first model's whole surface to the second model."""
    inside: InsideAgreement | None


class Comparison(TypedDict):
    """The comparison of two models, as ``meshmend compare --json`` prints it."""

    before: ComparedModel
    after: ComparedModel
    comparison: ComparisonFigures
