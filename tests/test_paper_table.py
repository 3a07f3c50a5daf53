"""The table behind "The papers, line by line" (`docs/papers.toml`) names what there is, and leaves no equation out."""

import ast
import importlib
import re
from functools import cache, reduce

import pytest

from docs.pages import notebook_headings, paper_line, paper_table, papers_page
from tests.pages import ROOT
from workbench.config import PRESETS
from workbench.energies import TABLE

PAPERS = {paper["name"]: paper["lines"] for paper in paper_table(ROOT)}
LINES = [line for lines in PAPERS.values() for line in lines]


def named(key: str) -> list[str]:
    """Every different entry of the table under a key."""
    return sorted({entry for line in LINES for entry in line.get(key, ())})


def equations(name: str) -> set[int]:
    """The numbers of a paper's equations that the table has, ranges spelt out."""
    found = set()
    for line in PAPERS[name]:
        for first, last in re.findall(r"Eqs?\. (\d+)(?:–(\d+))?", line["place"]):
            found |= set(range(int(first), int(last or first) + 1))
    return found


@cache
def offered_by(file: str) -> set[str]:
    """What pytest may be asked for in a test file: functions, classes, and functions of classes."""
    found = set()
    for node in ast.parse((ROOT / "tests" / file).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}::{part.name}" for part in node.body if isinstance(part, ast.FunctionDef)}
    return found


@pytest.mark.parametrize("name", named("code"))
def test_every_named_function_exists(name):
    module, _, path = name.partition(":")
    thing = reduce(getattr, path.split("."), importlib.import_module(module))
    assert callable(thing) or path.isupper()


@pytest.mark.parametrize("name", named("tests"))
def test_every_named_test_exists(name):
    file, _, test = name.partition("::")
    assert offered_by(file)
    assert not test or test in offered_by(file)


@pytest.mark.parametrize("place", named("notebooks"))
def test_every_named_cell_exists(place):
    name, begins = place.split("#")
    assert [heading for heading in notebook_headings(ROOT, name) if heading.startswith(begins)]


@pytest.mark.parametrize("key", named("settings"))
def test_every_named_setting_is_one_of_a_configuration(key):
    reduce(dict.__getitem__, key.split("."), PRESETS["joint"].model_dump())


@pytest.mark.parametrize("line", LINES, ids=lambda line: f"{line['place']}: {line['says'][:30]}")
def test_every_line_says_where_it_is_what_it_is_and_what_tests_it(line):
    assert set(line) <= {"place", "says", "term", "code", "settings", "notebooks", "tests", "differs"}
    assert line.get("term") in {None, *TABLE}
    assert line.get("code") or line.get("term")
    assert line["tests"]


def test_the_table_has_every_equation():
    assert equations("FACE IT!") == set(range(1, 13))
    assert equations("Deep Energies") == {1, 2, 3}


@pytest.mark.parametrize("name", [name for name, term in TABLE.items() if term.source])
def test_every_term_with_a_source_has_a_line_in_its_papers(name):
    for paper, lines in PAPERS.items():
        assert (paper in TABLE[name].source) <= any(line.get("term") == name for line in lines)


def test_the_page_has_every_line_with_its_formula_and_its_deviation():
    page = papers_page(ROOT)
    for line in LINES:
        assert f"### {line['place']}: {line['says']}" in page
        assert line.get("differs", "As printed.") in page
    (tau,) = [line for line in LINES if line.get("term") == "tau"]
    section = "\n".join(paper_line(ROOT, tau))
    for part in (TABLE["tau"].formula, "workbench.energies.temporal.tau_residual", "`weights.tau`", "notebooks/05_"):
        assert part in section
