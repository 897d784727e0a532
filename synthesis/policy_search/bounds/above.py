"""An upper bound on what given policies attain, as tensor trains: the other side of ``train_backward``.

The same recursion, and added to it what a lower bound counts as failed although the continuous system may survive. With
A the visited cells (outside which the trains of the lower bound are 0), and v_i the cells in which agent i has a choice
(docs/theory/bounds.md, "Upper bounds, and of what"),

    U_q,t+1 = (P_1^pi x .. x P_I^pi) (W_q 1[in A])  +  (prod_i P_i^pi 1[anywhere] - prod_i P_i^pi 1[in A])
              + (1 - prod_i v_i) ,          W_q = sum_q' 1[the letter leads q to q'] U_q',t .

So U is the probability of succeeding, of leaving A inside the workspaces, or of meeting a cell without a choice, before
failing. What it adds to a value are four columns per bond at most. It bounds the closed loop from above where nothing
is lost at region and workspace edges (``Abstraction.is_exact``).
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...abstraction.models import JointModel, Policies
from ...certificates.value_functions import Rounding, Train, Trains, counted_as_failed, routes
from ..ascent import backward


def evaluate_above(joint: JointModel, policies: Policies, rounding: Rounding) -> Trains:
    """Return the function U of the module's text at time 0, an upper bound once its error is added.

    It is rounded as the lower bound was.
    """

    def beside(t: int, q: int) -> Train | None:
        points = [model.choices.points(policy[t, q]) for model, policy in zip(joint.models, policies, strict=True)]
        backup = [model.kernel.backup for model in joint.models]
        return counted_as_failed(points, backup, joint.n_cells, rounding.visited[t], rounding.visited[t + 1])

    ways = routes(joint.guards, joint.masks, joint.n_states)
    choose = partial(_frozen, policies)
    return backward(joint, ways, choose, rounding.tolerance, None, rounding.visited, beside)


def _frozen(policies: Policies, t: int, q: int, _: Train) -> list[NDArray[np.int32]]:
    """Return the policies of a time and state as they are."""
    return [policy[t, q] for policy in policies]
