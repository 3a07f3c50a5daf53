"""Widgets for notebooks: a value and a callback each; the arithmetic lives in functions that need no browser."""

from workbench.widgets.playground import FitPlayground as FitPlayground
from workbench.widgets.playground import adjusted as adjusted
