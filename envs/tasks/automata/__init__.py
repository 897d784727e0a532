"""From LTL, HOA or a table to the minimal DFA.

From LTL on finite traces, HOA text or a table of transitions to the minimal DFA. Knows no agents.
"""

from .automaton import OPPOSITE, SEMANTICS, Automaton, followed
from .by_hand import automaton_from_transitions
from .covers import Cube, cover
from .cut_windows import is_cut, with_time_left
from .decision_diagram import DecisionDiagrams, DiagramSizeError
from .formula import RESERVED, Formula, FormulaError
from .guard_diagrams import letter_text
from .hoa import automaton_from_hoa
from .normal_form import NormalForm
from .parser import parse_formula
from .rebuilt import automaton_from_diagrams, over_propositions, with_meanings, within
from .translation import AutomatonSizeError, translate
from .windows import ahead, fitting, may_accept, met_in_time

__all__ = [
    "Automaton",
    "Cube",
    "DecisionDiagrams",
    "DiagramSizeError",
    "Formula",
    "FormulaError",
    "NormalForm",
    "OPPOSITE",
    "RESERVED",
    "SEMANTICS",
    "ahead",
    "automaton_from_diagrams",
    "automaton_from_hoa",
    "automaton_from_transitions",
    "cover",
    "fitting",
    "followed",
    "is_cut",
    "letter_text",
    "may_accept",
    "met_in_time",
    "over_propositions",
    "parse_formula",
    "AutomatonSizeError",
    "translate",
    "with_meanings",
    "with_time_left",
    "within",
]
