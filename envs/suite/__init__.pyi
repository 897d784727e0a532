from .catalogue import made_by as made_by
from .catalogue import make_problem as make_problem
from .catalogue import problem_ids as problem_ids
from .catalogue import tier_of_id as tier_of_id
from .constructors import (
    aec_env as aec_env,
)
from .constructors import (
    central_env as central_env,
)
from .constructors import (
    make as make,
)
from .constructors import (
    module_of as module_of,
)
from .constructors import (
    parallel_env as parallel_env,
)
from .constructors import (
    resolve as resolve,
)
from .constructors import (
    team_env as team_env,
)
from .constructors import (
    vector_env as vector_env,
)
from .ids import IDS as IDS
from .ids import MODULES as MODULES
from .ids import gymnasium_id as gymnasium_id
from .naming import as_problem as as_problem
from .registration import register_suite as register_suite

__all__ = [
    "IDS",
    "MODULES",
    "aec_env",
    "as_problem",
    "central_env",
    "gymnasium_id",
    "made_by",
    "make",
    "make_problem",
    "module_of",
    "parallel_env",
    "problem_ids",
    "register_suite",
    "resolve",
    "team_env",
    "tier_of_id",
    "vector_env",
]
