"""The public names of `certigym`, which are loaded when they are first used (SPEC 1, `lazy_loader`)."""

from .envs.agents import Agent as Agent
from .envs.agents import LinearAgent as LinearAgent
from .envs.agents import Pair as Pair
from .envs.agents import Proposition as Proposition
from .envs.logic import Automaton as Automaton
from .envs.logic import FormulaError as FormulaError
from .envs.logic import automaton_from_hoa as automaton_from_hoa
from .envs.logic import automaton_from_transitions as automaton_from_transitions
from .envs.logic import translate as translate
from .envs.problem import Problem as Problem
from .envs.problem import Specification as Specification
from .envs.problem import load_problem as load_problem
from .envs.problem import split_axes as split_axes
from .envs.suite import aec_env as aec_env
from .envs.suite import central_env as central_env
from .envs.suite import make_problem as make_problem
from .envs.suite import parallel_env as parallel_env
from .envs.suite import problem_ids as problem_ids
from .envs.suite import team_env as team_env
from .envs.suite import vector_env as vector_env
from .synthesis.balls import check_rigorous as check_rigorous
from .synthesis.bridges import as_policy as as_policy
from .synthesis.bridges import save_policy as save_policy
from .synthesis.certificates import Certificate as Certificate
from .synthesis.certificates import Synthesis as Synthesis
from .synthesis.certificates import load_certificate as load_certificate
from .synthesis.certificates import save_certificate as save_certificate
from .synthesis.certify import certify as certify
from .synthesis.certify import improve as improve
from .synthesis.checking import check as check
from .synthesis.checking import safety_rate as safety_rate
from .synthesis.checking import value_in_time as value_in_time
from .synthesis.controllers import Controller as Controller
from .synthesis.controllers import InputTable as InputTable
from .synthesis.horizons import synthesize_horizons as synthesize_horizons
from .synthesis.horizons import without_deadline as without_deadline
from .synthesis.models import abstract as abstract
from .synthesis.nominal_paths import certified_starts as certified_starts
from .synthesis.permissions import Permission as Permission
from .synthesis.permissions import check_permission as check_permission
from .synthesis.permissions import load_permission as load_permission
from .synthesis.permissions import permit as permit
from .synthesis.permissions import save_permission as save_permission
from .synthesis.raw_networks import repair_network as repair_network
from .synthesis.shielding import Shield as Shield
from .synthesis.synthesize import synthesize as synthesize
from .synthesis.upper_ends import bound_above as bound_above
from .validation.audits import AuditReport as AuditReport
from .validation.audits import audit as audit
from .validation.policies import Comparison as Comparison
from .validation.policies import Probe as Probe
from .validation.policies import as_controller as as_controller
from .validation.policies import compare as compare
from .validation.policies import leaderboard as leaderboard
from .validation.policies import probe as probe
from .validation.policies import record as record
from .validation.policies import train as train
from .validation.reports import report as report
from .validation.shields import shield as shield
from .validation.shields import shielded as shielded
from .validation.simulation import Mismatch as Mismatch
from .validation.simulation import Rollouts as Rollouts
from .validation.simulation import TrialPlan as TrialPlan
from .validation.simulation import rollout as rollout
from .validation.verdicts import FieldReport as FieldReport
from .validation.verdicts import StressReport as StressReport
from .validation.verdicts import ValidationReport as ValidationReport
from .validation.verdicts import stress as stress
from .validation.verdicts import validate as validate
from .validation.verdicts import validate_field as validate_field
from .validation.verdicts import validate_horizons as validate_horizons

__version__: str

__all__ = [
    "Agent",
    "Automaton",
    "AuditReport",
    "Certificate",
    "Comparison",
    "Controller",
    "FieldReport",
    "FormulaError",
    "InputTable",
    "LinearAgent",
    "Mismatch",
    "Pair",
    "Permission",
    "Probe",
    "Problem",
    "Proposition",
    "Rollouts",
    "Shield",
    "Specification",
    "StressReport",
    "Synthesis",
    "TrialPlan",
    "ValidationReport",
    "__version__",
    "abstract",
    "aec_env",
    "as_controller",
    "as_policy",
    "audit",
    "automaton_from_hoa",
    "automaton_from_transitions",
    "central_env",
    "certify",
    "bound_above",
    "check",
    "check_permission",
    "check_rigorous",
    "compare",
    "improve",
    "leaderboard",
    "load_certificate",
    "load_permission",
    "load_problem",
    "make_problem",
    "parallel_env",
    "permit",
    "probe",
    "problem_ids",
    "record",
    "report",
    "rollout",
    "save_certificate",
    "save_permission",
    "save_policy",
    "safety_rate",
    "shield",
    "shielded",
    "split_axes",
    "stress",
    "synthesize",
    "synthesize_horizons",
    "team_env",
    "train",
    "translate",
    "validate",
    "validate_field",
    "validate_horizons",
    "value_in_time",
    "vector_env",
    "without_deadline",
]
