"""Changes of one line that a test should notice: operators, limits, signs, conditions, and checks that are left out."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

COMPARE = {
    ast.Lt: ("<=", ">="), ast.LtE: ("<", ">"), ast.Gt: (">=", "<="), ast.GtE: (">", "<"), ast.Eq: ("!=",),
    ast.NotEq: ("==",), ast.Is: ("is not",), ast.IsNot: ("is",), ast.In: ("not in",), ast.NotIn: ("in",),
}  # fmt: skip
ARITHMETIC = {
    ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*", ast.Pow: "*", ast.FloorDiv: "/", ast.Mod: "//",
    ast.BitAnd: "|", ast.BitOr: "&", ast.BitXor: "&",
}  # fmt: skip
SWAPPED = [
    ("min", "max"), ("minimum", "maximum"), ("nanmin", "nanmax"), ("argmin", "argmax"), ("any", "all"),
    ("floor", "ceil"), ("mean", "sum"), ("nanmean", "nansum"), ("startswith", "endswith"), ("left", "right"),
    ("warn", "error"), ("zeros", "ones"), ("sin", "cos"), ("union", "intersection"),
]  # fmt: skip
CALLS = dict(SWAPPED) | {new: old for old, new in SWAPPED}
# Guards of Python itself, not of this program's results.
KEYWORDS = {"strict", "frozen", "slots", "encoding", "newline", "copy", "repr", "kw_only"}


@dataclass(frozen=True)
class Mutant:
    """One change: `old` at byte `start` of a file becomes `new`; `line` counts from 1."""

    file: Path
    line: int
    start: int
    old: bytes
    new: bytes

    def text(self) -> str:
        """The change in one line."""
        old, new = (" ".join(part.decode().split())[:70] for part in (self.old, self.new))
        return f"{self.file}:{self.line}: {old} -> {new}"


class Changes(ast.NodeVisitor):
    """Collects every change of one file that this script knows."""

    def __init__(self, file: Path, source: bytes) -> None:
        self.file, self.source = file, source
        self.starts = [0]
        for row in source.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(row))
        self.found: list[Mutant] = []
        self.depth = 0

    def at(self, line: int, column: int) -> int:
        return self.starts[line - 1] + column

    def span(self, node: Any) -> tuple[int, int]:
        return self.at(node.lineno, node.col_offset), self.at(node.end_lineno, node.end_col_offset)

    def text(self, node: ast.AST) -> str:
        start, end = self.span(node)
        return self.source[start:end].decode()

    def add(self, node: Any, new: str) -> None:
        start, end = self.span(node)
        self.found.append(Mutant(self.file, node.lineno, start, self.source[start:end], new.encode()))

    def between(self, left: Any, right: Any, old: str, new: str) -> None:
        """Change the operator that stands between two operands, brackets and comments aside."""
        start, end = self.span(left)[1], self.span(right)[0]
        at = self.source.find(old.encode(), start, end)
        if at >= 0:
            line = self.source.count(b"\n", 0, at) + 1
            self.found.append(Mutant(self.file, line, at, old.encode(), new.encode()))

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        self.depth += 1
        for default in (*node.args.defaults, *(d for d in node.args.kw_defaults if d is not None)):
            self.visit(default)
        for part in node.body:
            self.visit(part)
        self.depth -= 1

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Words and their formats are left alone."""

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg not in KEYWORDS:
            self.visit(node.value)

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        for part in node.body:
            self.visit(part)

    def visit_Compare(self, node: ast.Compare) -> None:
        operands = [node.left, *node.comparators]
        for left, operator, right in zip(operands, node.ops, operands[1:], strict=False):
            old = ast.unparse(ast.Compare(ast.Name("a"), [operator], [ast.Name("b")]))[2:-2]
            for new in COMPARE[type(operator)]:
                self.between(left, right, old, new)
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        new = ARITHMETIC.get(type(node.op))
        if new and not (self.depth == 0 and isinstance(node.op, ast.BitOr)):
            old = ast.unparse(ast.BinOp(ast.Name("a"), node.op, ast.Name("b")))[1:-1].strip()
            self.between(node.left, node.right, old, new)
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        new = {ast.Add: "-=", ast.Sub: "+=", ast.Mult: "/="}.get(type(node.op))
        if new:
            self.between(node.target, node.value, {"-=": "+=", "+=": "-=", "/=": "*="}[new], new)
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        old, new = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in zip(node.values, node.values[1:], strict=False):
            self.between(left, right, old, new)
        for value in node.values:
            self.add(value, "True" if old == "and" else "False")
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if not isinstance(node.op, ast.UAdd):
            self.add(node, f"({self.text(node.operand)})")
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool):
            self.add(node, str(not value))
        elif isinstance(value, int):
            self.add(node, str(value + 1))
            if value:
                self.add(node, f"({value - 1})" if value < 1 else str(value - 1))
        elif isinstance(value, float):
            self.add(node, f"(-{self.text(node)})" if value else "1.0")
            if value:
                self.add(node, f"(1.5 * {self.text(node)})")

    def visit_Call(self, node: ast.Call) -> None:
        name = node.func
        word = name.attr if isinstance(name, ast.Attribute) else getattr(name, "id", "")
        if word in CALLS:
            _, end = self.span(name)
            old = word.encode()
            self.found.append(Mutant(self.file, node.lineno, end - len(old), old, CALLS[word].encode()))
        elif word in ("abs", "sorted", "set", "nan_to_num", "unique") and len(node.args) == 1 and not node.keywords:
            self.add(node, f"({self.text(node.args[0])})")
        self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> None:
        self.add(node, "pass")

    def visit_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Call):
            self.add(node, "pass")
            self.generic_visit(node)

    def visit_Continue(self, node: ast.Continue) -> None:
        self.add(node, "break")

    def visit_Break(self, node: ast.Break) -> None:
        self.add(node, "continue")

    def visit_If(self, node: ast.If) -> None:
        self.add(node.test, "True")
        self.add(node.test, "False")
        self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self.add(node.test, "True")
        self.add(node.test, "False")
        self.generic_visit(node)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        for test in node.ifs:
            self.add(test, "True")
        self.generic_visit(node)

    def visit_Return(self, node: ast.Return) -> None:
        if isinstance(node.value, ast.Name | ast.Attribute | ast.Call) and self.depth:
            self.add(node.value, "None")
        self.generic_visit(node)


def changes(root: Path, sources: Sequence[Path]) -> list[Mutant]:
    """Every change of modules (files, or folders of them) below `root` that still is Python."""
    out: list[Mutant] = []
    for path in sources:
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            source = file.read_bytes()
            finder = Changes(file.relative_to(root), source)
            finder.visit(ast.parse(source))
            for mutant in dict.fromkeys(finder.found):
                with suppress(SyntaxError):
                    ast.parse(changed(source, mutant))
                    out.append(mutant)
    return out


def changed(source: bytes, mutant: Mutant) -> bytes:
    return source[: mutant.start] + mutant.new + source[mutant.start + len(mutant.old) :]
