"""The public names of `certigym`, which are loaded when they are first used (SPEC 1, `lazy_loader`)."""

from .envs.suite import aec_env as aec_env
from .envs.suite import central_env as central_env
from .envs.suite import make as make
from .envs.suite import make_problem as make_problem
from .envs.suite import parallel_env as parallel_env
from .envs.suite import problem_ids as problem_ids
from .envs.suite import team_env as team_env
from .envs.suite import vector_env as vector_env
from .envs.systems.agents import Agent as Agent
from .envs.systems.agents import LinearAgent as LinearAgent
from .envs.tasks.automata import Automaton as Automaton
from .envs.tasks.automata import FormulaError as FormulaError
from .envs.tasks.automata import translate as translate
from .envs.tasks.problem import Problem as Problem
from .envs.tasks.problem import Specification as Specification
from .envs.tasks.regions import Pair as Pair
from .envs.tasks.regions import Proposition as Proposition
from .synthesis.certificates.proofs import Certificate as Certificate
from .synthesis.certificates.proofs import Synthesis as Synthesis
from .synthesis.extended_check.claims import safety_rate as safety_rate
from .synthesis.extended_check.claims import value_in_time as value_in_time
from .synthesis.extended_check.shields import Shield as Shield
from .synthesis.interop import as_policy as as_policy
from .synthesis.verbs.abstract import abstract as abstract
from .synthesis.verbs.certify import certify as certify
from .synthesis.verbs.certify import improve as improve
from .synthesis.verbs.in_files import check as check
from .synthesis.verbs.in_files import load as load
from .synthesis.verbs.in_files import save as save
from .synthesis.verbs.search_options import SearchOptions as SearchOptions
from .synthesis.verbs.synthesize import synthesize as synthesize
from .validation.policies import as_controller as as_controller
from .validation.policies import compare as compare
from .validation.policies import leaderboard as leaderboard
from .validation.policies import probe as probe
from .validation.policies import record as record
from .validation.policies import shield as shield
from .validation.policies import train as train
from .validation.presentation.reports import report as report
from .validation.statistical_tests import Mismatch as Mismatch
from .validation.statistical_tests import audit as audit
from .validation.statistical_tests import rollout as rollout
from .validation.statistical_tests import stress as stress
from .validation.statistical_tests import validate as validate
from .validation.statistical_tests import validate_field as validate_field

__version__: str

__all__ = [
    "Agent",
    "Automaton",
    "Certificate",
    "FormulaError",
    "LinearAgent",
    "Mismatch",
    "Pair",
    "Problem",
    "Proposition",
    "SearchOptions",
    "Shield",
    "Specification",
    "Synthesis",
    "__version__",
    "abstract",
    "aec_env",
    "as_controller",
    "as_policy",
    "audit",
    "central_env",
    "certify",
    "check",
    "compare",
    "improve",
    "leaderboard",
    "load",
    "make",
    "make_problem",
    "parallel_env",
    "probe",
    "problem_ids",
    "record",
    "report",
    "rollout",
    "safety_rate",
    "save",
    "shield",
    "stress",
    "synthesize",
    "team_env",
    "train",
    "translate",
    "validate",
    "validate_field",
    "value_in_time",
    "vector_env",
]
