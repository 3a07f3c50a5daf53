"""JavaScript of the widgets in tests: how long its functions are, and what the pure ones return, asked of Node."""

import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from pygments.lexers import JavascriptLexer
from pygments.token import Punctuation

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="Node is not installed")
NOT_CALLED = {"if", "for", "while", "switch", "catch", "with"}
"""Words before round brackets whose block is no function."""


def asked_of_node(module: Path, names: str, expression: str) -> object:
    """The value of an expression of what a module exports, as JSON carries it."""
    code = f"import {{ {names} }} from {json.dumps(module.as_uri())};\nconsole.log(JSON.stringify({expression}));"
    command = [NODE, "--input-type=module", "--eval", code]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def functions(source: str) -> Iterator[tuple[int, int]]:
    """(first line, lines) of every function with a body in braces."""
    braces, brackets, last, closed = [], [], "", ""
    for text, line in _words(source):
        if text == "(":
            brackets.append(last)
        elif text == ")":
            closed = brackets.pop()
        elif text == "{":
            braces.append((last == "=>" or (last == ")" and closed not in NOT_CALLED), line))
        elif text == "}":
            is_function, first = braces.pop()
            if is_function:
                yield first, line - first + 1
        last = text


def _words(source: str) -> Iterator[tuple[str, int]]:
    """Words and brackets with their lines, without strings and comments."""
    line = 1
    for kind, text in JavascriptLexer(stripnl=False).get_tokens(source):
        if kind in Punctuation and text != "=>":
            yield from ((letter, line) for letter in text)
        elif text.strip() and "Comment" not in str(kind) and "String" not in str(kind):
            yield text, line
        line += text.count("\n")
