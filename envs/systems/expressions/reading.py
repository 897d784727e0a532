"""From text to expression trees; nothing is ever run.

The grammar is that of Python expressions. Its parser (`ast.parse`) gives a tree of nodes, of which a few kinds are
allowed; the tree is walked and never compiled. Libraries that evaluate expressions (`asteval`, `numexpr`, `sympy`)
were looked at: they run more of Python than is wanted here, or have no enclosures, which need a tree of their own.

Texts come from files, so nothing in them is trusted: characters, length and nesting are checked before Python's parser
sees them.
"""

from __future__ import annotations

import ast
import keyword
import re
from collections.abc import Collection, Iterator, Mapping
from difflib import get_close_matches

from .expression_tree import FUNCTIONS, Name, Number, Operation, Tree, with_numbers

MOST_CHARACTERS = 5_000
"""Most characters of an expression: far more than people write, and read within milliseconds."""

MOST_OPERATIONS = 1_000
"""Most operations of an expression."""

DEEPEST = 150
"""Deepest nesting, of parentheses and of operations: readings call themselves as often."""

MOST_POWERS, MOST_SIGNS = 50, 8
"""Most powers, and most signs in a row: both nest without brackets, in Python's parser, too."""

LARGEST = 1e100
"""Largest number: as for all numbers of a problem."""

CONSTANTS = {"pi": 3.141592653589793}
"""Names that are numbers."""

RESERVED = frozenset([*FUNCTIONS, *CONSTANTS])
"""Names that cannot be given to states, inputs, parameters or disturbances."""

# Blanks, a number, a name (with a dot: a state of another agent), an operator, or any other character (an error).
_TOKEN = re.compile(
    r"[ \t\r\n]+|((?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?(?![A-Za-z0-9_.]))"
    r"|([A-Za-z_][A-Za-z0-9_]*(?:\.[A-Za-z_][A-Za-z0-9_]*)?)|(\*\*|[-+*/(),])|(.)",
    re.DOTALL,
)
_HINTS = {
    "[": "brackets are round",
    "{": "brackets are round",
    "=": "give the right-hand side alone",
    "'": "give the right-hand side alone, the value one step later",
    "<": "there are no comparisons; use min, max, clip or abs",
    ">": "there are no comparisons; use min, max, clip or abs",
    "%": "there is no remainder",
}
_CHOICES = ("if", "else", "and", "or", "not")
_OPERATORS: dict[type[ast.AST], str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}


class ExpressionError(ValueError):
    """An expression that cannot be read.

    Attributes
    ----------
    problem : str
        What is wrong, in words.
    text : str
        The expression.
    start : int
        Place of the mistake, counted from 0.
    """

    def __init__(self, problem: str, text: str = "", start: int = 0) -> None:
        self.problem, self.text, self.start = problem, text, start
        # Long expressions are cut around the place, so that the caret stands under it on one line.
        first = max(0, start - 60)
        shown = "".join(" " if c.isspace() or not c.isprintable() else c for c in text[first : start + 40])
        super().__init__(f"{problem}\n    {shown}\n    {' ' * (start - first)}^" if text else problem)


def read_expression(text: object, names: Collection[str], numbers: Mapping[str, float] | None = None) -> Tree:
    """Return the tree of an expression.

    Parameters
    ----------
    text : str
        Powers are written ``x**2`` or ``x^2``.
    names : collection of str
        Names that may occur.
    numbers : mapping from str to float, optional
        Names that are numbers; they are put in.

    Raises
    ------
    ExpressionError
        If the text is not an expression in these names. The message points at the place.

    Examples
    --------
    >>> read_expression("2*x", ["x"])
    Operation(name='*', arguments=(Number(value=2.0), Name(name='x')))
    """
    if not isinstance(text, str):
        raise ExpressionError(f"expected an expression, got {type(text).__name__}")
    if len(text) > MOST_CHARACTERS:
        raise ExpressionError(f"expected at most {MOST_CHARACTERS} characters, got {len(text)}")
    numbers = {} if numbers is None else numbers
    text = text.replace("^", "**")
    _check_characters(text)
    # Python's parser takes neither leading blanks nor line breaks; both are kept as places to count from.
    plain = re.sub(r"\s", " ", text)
    indent = len(plain) - len(plain.lstrip())
    if not plain.strip():
        raise ExpressionError("expected an expression, got an empty text")
    try:
        root = ast.parse(plain.strip(), mode="eval").body
    except SyntaxError as error:
        place = indent + max(0, (error.offset or 1) - 1)
        raise ExpressionError("expected an expression such as `x + 0.1*sin(y)`", text, place) from None
    except (RecursionError, MemoryError):
        raise ExpressionError(f"expected at most {DEEPEST} levels of nesting") from None
    reader = _Reader(text, indent, {*names, *numbers})
    tree = reader.tree(root, 0)
    try:
        return with_numbers(tree, numbers)
    except ArithmeticError as error:
        raise ExpressionError(f"expected numbers that can be computed with, got {error}", text) from None


def checked_variable(name: object, argument: str) -> str:
    """Return a name that can stand in expressions, or raise ValueError."""
    is_name = isinstance(name, str) and re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name)
    if not isinstance(name, str) or not is_name or keyword.iskeyword(name) or name in RESERVED:
        raise ValueError(
            f"`{argument}`: expected letters, digits and underscores, no function, no word of Python, got {name!r:.60}"
        )
    return name


def _check_characters(text: str) -> None:
    """Raise ExpressionError at characters, numbers and nesting that no expression has."""
    depth = signs = powers = 0
    for number, name, operator, stray, place in _tokens(text):
        if stray:
            hint = _HINTS.get(stray, "expected numbers, names, + - * / ** and round brackets")
            raise ExpressionError(f"unexpected {stray!r}: {hint}", text, place)
        if number and not float(number) <= LARGEST:
            raise ExpressionError(f"expected numbers of at most {LARGEST:g}", text, place)
        if name and keyword.iskeyword(name):
            remedy = "there are no conditions; use min, max, clip or abs" if name in _CHOICES else "use another name"
            raise ExpressionError(f"{name!r} is a word of Python; {remedy}", text, place)
        depth += {"(": 1, ")": -1}.get(operator, 0)
        signs = signs + 1 if operator in ("+", "-") else 0
        powers += operator == "**"
        if depth > DEEPEST or signs > MOST_SIGNS or powers > MOST_POWERS:
            raise ExpressionError(
                f"expected at most {DEEPEST} brackets in one another, {MOST_SIGNS} signs in a row and "
                f"{MOST_POWERS} powers",
                text,
                place,
            )


def _tokens(text: str) -> Iterator[tuple[str, str, str, str, int]]:
    """Yield number, name, operator or stray character (the others empty), and the place of each token."""
    for match in _TOKEN.finditer(text):
        if match.lastindex:
            number, name, operator, stray = (match.group(k) or "" for k in (1, 2, 3, 4))
            yield number, name, operator, stray, match.start()


class _Reader:
    """Walks over the nodes of Python's parser."""

    def __init__(self, text: str, indent: int, names: Collection[str]) -> None:
        self.text, self.indent, self.names = text, indent, names
        self.count = 0

    def error(self, problem: str, node: ast.expr) -> ExpressionError:
        """Return the error at a node."""
        return ExpressionError(problem, self.text, self.indent + node.col_offset)

    def tree(self, node: ast.expr, depth: int) -> Tree:
        """Return the tree of a node and everything below it."""
        self.count += 1
        if self.count > MOST_OPERATIONS or depth > DEEPEST:
            limit = f"{DEEPEST} levels of nesting" if depth > DEEPEST else f"{MOST_OPERATIONS} operations"
            raise ExpressionError(f"expected at most {limit}; name parts of it as states, or shorten it")
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
            return Number(float(node.value))
        if isinstance(node, ast.Name):
            return self.name(node.id, node)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            return self.name(f"{node.value.id}.{node.attr}", node)
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
            argument = self.tree(node.operand, depth + 1)
            if isinstance(node.op, ast.UAdd):
                return argument
            # A sign before a number belongs to it, so that x**-2 has a whole exponent.
            return Number(-argument.value) if isinstance(argument, Number) else Operation("negative", (argument,))
        if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            sides = self.tree(node.left, depth + 1), self.tree(node.right, depth + 1)
            return Operation(_OPERATORS[type(node.op)], sides)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            return self.call(node.func.id, node, depth)
        raise self.error("expected numbers, names, + - * / ** and functions only", node)

    def name(self, name: str, node: ast.expr) -> Tree:
        """Return the tree of a name, or raise ExpressionError with the known name that it resembles."""
        if name in self.names:
            return Name(name)
        if name in CONSTANTS:
            return Number(CONSTANTS[name])
        if name in FUNCTIONS:
            raise self.error(f"{name!r} is a function and needs arguments in brackets", node)
        raise self.error(f"unknown name {name!r:.40}; {_nearest(name, [*sorted(self.names), *CONSTANTS])}", node)

    def call(self, name: str, node: ast.Call, depth: int) -> Tree:
        """Return the tree of a function with its arguments."""
        if name not in FUNCTIONS:
            raise self.error(f"unknown function {name!r:.40}; {_nearest(name, list(FUNCTIONS))}", node)
        few, given = FUNCTIONS[name], len(node.args)
        if given < few or (given > few and name not in ("min", "max")):
            raise self.error(f"{name} takes {few} argument{'s' * (few > 1)}, got {given}", node)
        # Further arguments of `min` and `max` nest.
        arguments = [self.tree(argument, depth + max(2, given)) for argument in node.args]
        if name == "clip":
            raised = Operation("max", (arguments[0], arguments[1]))
            return Operation("min", (raised, arguments[2]))
        result = Operation(name, tuple(arguments[:few]))
        for argument in arguments[few:]:
            result = Operation(name, (result, argument))
        return result


def _nearest(name: str, known: list[str]) -> str:
    """Return a remedy: the known name that resembles a wrong one, or all of them."""
    close = get_close_matches(name, [one for one in known if len(one) > 1], n=1)  # `dt` is not a mistyped `t`
    return f"did you mean {close[0]!r}?" if close else f"there are {', '.join(known[:12])}"
