"""Sphinx extension: words that readers search for lead to the page that answers them, before all other results."""

from __future__ import annotations

from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.transforms import SphinxTransform

SEARCHED = {
    "how-to/faq": ["timeout", "time limit", "my bound is 0", "my bound is small", "slow", "too slow", "bound is 0"],
    "how-to/own_problem": ["LTL", "linear temporal logic", "formula", "obstacle", "my own environment"],
    "tutorials/my_robot": ["my robot", "getting started"],
    "tutorials/safety_filter": ["safety filter", "shield", "safe exploration", "safe rl"],
    "tutorials/sb3_policy": ["stable-baselines3", "sb3", "ppo"],
    "tutorials/check_a_certificate": ["verify", "check a certificate", "forged"],
    "tutorials/paper_plot": ["plot", "figure", "matplotlib"],
    "how-to/networks": ["neural network", "network", "lqr", "feedback"],
    "how-to/policies_come_back": ["onnx", "torch", "jax", "pytorch"],
    "how-to/own_dynamics": ["nonlinear", "noise", "distribution", "disturbance", "angle"],
    "how-to/batches": ["gpu", "cuda"],
    "how-to/observations": ["observation", "sensor noise", "partial observability"],
    "how-to/clients": ["gymnasium", "pettingzoo"],
    "how-to/pairs": ["collision avoidance", "collision"],
    "how-to/validate": ["confidence interval", "rollouts", "monte carlo"],
    "theory/paths": ["trajectory", "tube", "chance constraint"],
    "limits": ["supported", "not supported"],
    "reference/glossary": ["glossary", "terminology"],
}
"""By page: what readers type, in small letters or as an abbreviation."""


class SearchedWords(SphinxTransform):
    """Give a page its main entries of the index, which the search of the site puts first."""

    default_priority = 400

    def apply(self, **kwargs: Any) -> None:
        """Add the entries at the first section, if the page has any."""
        sections = list(self.document.findall(nodes.section))
        words = SEARCHED.get(self.env.docname, [])
        if sections and words:
            entries = [("single", word.lower(), sections[0]["ids"][0], "main", None) for word in words]
            sections[0].insert(1, addnodes.index(entries=entries))


def outdated(*event: Any) -> list[str]:
    """Return the pages that every build reads again: entries of pages that are not read are lost from the search."""
    return list(SEARCHED)


def setup(app: Any) -> dict[str, bool]:
    """Register the extension."""
    app.add_transform(SearchedWords)
    app.connect("env-get-outdated", outdated)
    return {"parallel_read_safe": True}
