"""Rows of the field's benchmarks that need a grid: planar robots, oscillators, a car, rooms, and decoupled chains.

Every entry holds a problem and what is known about it, keyed as `row` of ``write_problems`` takes them. Where a tool
reports a mean over its cells, the start is drawn from the whole workspace; starts that are in the target, or lost at
once, are no cells of that tool, and ``sure`` and ``lost`` are the shares of the workspace that they take.
"""

from __future__ import annotations

from typing import Any

Content = dict[str, Any]
Entry = dict[str, Any]

IMPACT, REPORT, NOWHERE = "IMPaCT", "see its report", "machine not stated"
LATTICE = "its cells are centred on lattice points, so that its sets stick out by half a cell; these are ours as well"
FOREVER = "published without a deadline; ours has one, and so is a lower bound"


def problem(name: str, horizon: int, agents: list[Content], propositions: Content, formula: str, kind: str) -> Content:
    """Return a problem as plain values."""
    task = {"formula": formula, "semantics": kind}
    return {"name": name, "horizon": horizon, "agents": agents, "propositions": propositions, "specification": task}


def linear(cells: Any) -> Entry:
    """Return what asks for linear cells of a given number, where the default takes longer than a row should."""
    return {"relation": "linear", "cells": cells}


def planar(name: str, entries: tuple[float, float, float], side: float, variance: float, start: list[float]) -> Content:
    """Return a robot in the plane with diagonal matrices; entries are the two of A, and that of B."""
    first, second, gain = entries
    return {
        "name": name,
        "A": [[first, 0.0], [0.0, second]],
        "B": [[gain, 0.0], [0.0, gain]],
        "noise_covariance": [[variance, 0.0], [0.0, variance]],
        "state_low": [-side, -side],
        "state_high": [side, side],
        "input_low": [-1.0, -1.0],
        "input_high": [1.0, 1.0],
        "initial_state": start,
    }


def deliveries() -> list[Entry]:
    """Return package delivery with each of the variances in use."""
    entries = []
    for tag, variance, note in (
        ("0.2", 0.2, "reading: .2 is a variance"),
        ("0.2-deviation", 0.2**2, "reading: .2 is a standard deviation"),
        ("0.02", 0.02, "reading: variance .02; published: 1.0 for each of two halves of the task"),
    ):
        regions = {
            "p1": {"agent": "robot", "low": [5.0, -1.0], "high": [6.0, 1.0]},
            "p2": {"agent": "robot", "low": [0.0, -5.0], "high": [1.0, 1.0]},
            "p3": {"agent": "robot", "low": [-4.0, -4.0], "high": [-2.0, -3.0]},
        }
        robot = planar("robot", (0.9, 0.8, 1.4), 6.0, variance, [-5.0, -5.0])
        task = problem(f"package-delivery-{tag}", 60, [robot], regions, "F(p1 & (!p2 U p3))", "co-safe")
        known: Entry = {"note": f"{note}; from (-5, -5), 60 steps"}
        if tag == "0.2":
            known |= {"relation": "exact", "note": known["note"] + "; published: its value rebuilt by us, not in print",
                      "published": 0.9173, "tool": "SySCoRe", "seconds": 10.0, "machine": NOWHERE}  # fmt: skip
        if tag == "0.02":
            known |= {"tool": IMPACT, "seconds": 38.3, "machine": REPORT}
        entries.append({"content": task, **known})
    return entries


def parkings() -> list[Entry]:
    """Return the two parking problems."""
    line = {
        "name": "car", "A": [[0.9]], "B": [[0.7]], "noise_covariance": [[1.0]], "state_low": [-10.0],
        "state_high": [10.0], "input_low": [-1.0], "input_high": [1.0], "initial_state": [-4.0],
    }  # fmt: skip
    one = {"p1": {"agent": "car", "low": [4.75], "high": [6.0]}, "p2": {"agent": "car", "low": [6.0], "high": [10.0]}}
    two = {
        "p1": {"agent": "car", "low": [4.0, -4.0], "high": [10.0, 0.0]},
        "p2": {"agent": "car", "low": [4.0, 0.0], "high": [10.0, 4.0]},
    }
    plane = planar("car", (0.9, 0.9, 0.7), 10.0, 1.0, [-4.0, -5.0])
    rebuilt = "from (-4, -5); published: its value rebuilt by us, no number in print"
    known = {"published": 0.453, "tool": "SySCoRe", "seconds": 10.0, "machine": NOWHERE}
    return [
        {"content": problem("car-park-1", 40, [line], one, "!p2 U p1", "co-safe"), "note": "from -4, 40 steps"},
        {
            "content": problem("car-park-2", 40, [plane], two, "!p2 U p1", "co-safe"),
            "note": rebuilt,
            **known,
            **linear(80),
        },
    ]


def patrols() -> list[Entry]:
    """Return the patrol robot with its gains, target and pillar in each version, and with a disturbance."""
    entries = []
    for name, gain, target, pillar, side, pushed, steps in (
        ("patrol-minimal", 2, 8.0, 1.5, 10.0, False, 30),
        ("patrol-toy", 2, 7.0, 2.0, 10.0, False, 16),
        ("patrol-group", 10, 7.0, 2.0, 10.0, False, 30),
        ("patrol-group-disturbed", 10, 7.0, 2.0, 10.0, True, 30),
    ):
        robot: Content = {
            "name": "robot",
            "states": ["x", "y"],
            "inputs": ["speed", "course"],
            "dynamics": [f"{axis} + {gain}*speed*{turn}(course){' + push_' + axis if pushed else ''}"
                         for axis, turn in (("x", "cos"), ("y", "sin"))],
            "noise_covariance": [[0.75, 0.0], [0.0, 0.75]],
            "state_low": [-side, -side],
            "state_high": [side, side],
            "input_low": [-1.0, -1.0],
            "input_high": [1.0, 1.0],
            "initial_state": [-6.0, -6.0],
        }  # fmt: skip
        if pushed:
            robot["disturbances"] = {"push_x": [-0.5, 0.5], "push_y": [-0.5, 0.5]}
        regions = {
            "target": {"agent": "robot", "low": [5.0, 5.0], "high": [target, target]},
            "pillar": {"agent": "robot", "low": [-pillar, -pillar], "high": [pillar, pillar]},
        }
        note = f"gain {gain}, from (-6, -6), {steps} steps"
        entry: Entry = {"content": problem(name, steps, [robot], regions, "!pillar U target", "co-safe"), "note": note}
        if name == "patrol-group-disturbed":
            entry |= {"relation": "boxes", "cells": 80}
        elif name == "patrol-minimal":
            entry["note"] += "; published: about 1 inside its grid, without digits; " + FOREVER
            entry |= {"tool": IMPACT, "seconds": 842.5, "machine": REPORT}
        entries.append(entry)
    return entries


def oscillators() -> list[Entry]:
    """Return Van der Pol with an input, and without one in both of the forms in use."""
    entries = []
    goal = {"agent": "oscillator", "low": [-1.4, -2.9], "high": [-0.7, -2.0]}
    controlled = {
        "name": "oscillator", "states": ["x", "y"], "inputs": ["u"],
        "dynamics": ["x + 0.1*y", "y + 0.1*(-x + (1 - x**2)*y) + u"], "noise_covariance": [[0.2, 0.0], [0.0, 0.2]],
        "state_low": [-3.0, -3.0], "state_high": [3.0, 3.0], "input_low": [-1.0], "input_high": [1.0],
        "initial_state": [-1.0, 1.0],
    }  # fmt: skip
    note = "from (-1, 1), 40 steps; published: an hour and more, no number in print"
    known = {"tool": "SySCoRe", "seconds": 3600.0, "machine": NOWHERE}
    entries.append(
        {"content": problem("van-der-pol-controlled", 40, [controlled], {"goal": goal}, "F goal", "co-safe"),
         "note": note, **known, **linear(120)}
    )  # fmt: skip
    # No input moves these two: an input that nothing uses stands in for none.
    small = {"agent": "oscillator", "low": [-1.2, -2.9], "high": [-0.9, -2.0]}
    for tag, damping, start in (("as-run", "(1 - x)*(1 - x)", [-0.8, -1.8]), ("as-meant", "(1 - x**2)", [-0.6, -2.4])):
        free = {
            **controlled,
            "dynamics": ["x + 0.1*y", f"y + 0.1*(-x + {damping}*y)"],
            "noise_covariance": [[0.04, 0.0], [0.0, 0.04]],
            "state_low": [-5.1, -5.1],
            "state_high": [5.1, 5.1],
            "input_low": [0.0],
            "input_high": [0.0],
            "initial_state": start,
        }
        task = problem(f"van-der-pol-free-{tag}", 40, [free], {"goal": small}, "F goal", "co-safe")
        note = f"damping {damping}; from {start}, 40 steps"
        known = {"published": 0.2297, "tool": IMPACT, "seconds": 30.9, "machine": REPORT}
        if tag == "as-run":
            note += "; published: the largest value over its cells; " + FOREVER
        entries.append({"content": task, "note": note, **linear(160), **(known if tag == "as-run" else {})})
    return entries


def cars() -> list[Entry]:
    """Return the minimal automated vehicle: the largest value of a start, and the mean over all starts."""
    slip = "atan(tan(steering)/2)"
    car = {
        "name": "car",
        "states": ["x", "y", "heading"],
        "inputs": ["speed", "steering"],
        "dynamics": [
            f"x + 0.1*speed*cos({slip} + heading)/cos({slip})",
            f"y + 0.1*speed*sin({slip} + heading)/cos({slip})",
            "heading + 0.1*speed*tan(steering)",
        ],
        "noise_covariance": [[1 / 1.5, 0.0, 0.0], [0.0, 1 / 1.5, 0.0], [0.0, 0.0, 1 / 1.5]],
        "state_low": [-5.25, -5.25, -3.6],
        "state_high": [5.25, 5.25, 3.6],
        "input_low": [-1.0, -0.4],
        "input_high": [4.0, 0.4],
    }
    regions = {
        "target": {"agent": "car", "low": [-5.25, -0.25, -3.6], "high": [0.25, 5.25, 3.6]},
        "strip": {"agent": "car", "low": [-5.25, -0.75, -3.6], "high": [0.25, -0.25, 3.6]},
    }
    sampled = f"published from sampled enclosures, which its authors name as such; {LATTICE}; {FOREVER} (16 steps)"
    known = {"tool": IMPACT, "seconds": 1581.0, "machine": REPORT, **linear([21, 21, 18])}
    area = 10.5**2
    entries = []
    for tag, start, published in (
        ("largest", {"initial_state": [0.5, 2.0, 3.0]}, 0.3398),
        ("mean", {"initial_low": [-5.25, -5.25, -3.6], "initial_high": [5.25, 5.25, 3.6]}, 0.031),
    ):
        task = problem(f"vehicle-3-{tag}", 16, [{**car, **start}], regions, "!strip U target", "co-safe")
        entry: Entry = {"content": task, "note": sampled, "published": published, **known}
        if tag == "mean":
            entry |= {"sure": 5.5 * 5.5 / area, "lost": 5.5 * 0.5 / area}
        entries.append(entry)
    return entries


def integrators() -> list[Entry]:
    """Return the chain of two integrators over all starts: safe, and in the target within five steps."""
    low, high = [-10.25, -10.25], [10.25, 10.25]
    chain = {
        "name": "chain", "A": [[1.0, 0.1], [0.0, 1.0]], "B": [[0.005], [0.1]],
        "noise_covariance": [[0.01, 0.0], [0.0, 0.01]], "state_low": low, "state_high": high, "input_low": [-1.0],
        "input_high": [1.0], "initial_low": low, "initial_high": high,
    }  # fmt: skip
    known = {"tool": IMPACT, "seconds": 2.5, "machine": REPORT, **linear(80)}
    safe = problem("chain-2-safe-mean", 5, [chain], {"safe": {"agent": "chain", "low": low, "high": high}}, "G safe",
                   "finite-trace")  # fmt: skip
    target = {"agent": "chain", "low": [-8.25, -8.25], "high": [8.25, 8.25]}
    reach = problem("chain-2-reach-mean", 5, [chain], {"target": target}, "F target", "co-safe")
    note = f"mean over all starts; {LATTICE}"
    return [
        {"content": safe, "note": note, "published": 0.761, **known},
        {"content": reach, "note": note + "; starts outside the target", "published": 0.072, "sure": (16.5 / 20.5) ** 2,
         **known},
    ]  # fmt: skip


def rooms() -> list[Entry]:
    """Return rings of rooms: all heated and each told of its neighbours, and with two heaters for three or five."""
    entries = []
    for n, eta in ((3, 0.2), (5, 0.3), (100, 0.3), (1000, 0.3)):
        variance = 0.02 if n == 3 else 0.01
        agents = [_room(i, n, eta, variance) for i in range(n)]
        comfort = {"comfort": {"agent": "room_*", "low": [19.0], "high": [21.0]}}
        task = problem(f"rooms-{n}-all-heated", 8, agents, comfort, "G all(comfort)", "finite-trace")
        entries.append({"content": task, "note": "a heater in every room, each told of its neighbours"})
    return entries


def _room(i: int, n: int, eta: float, variance: float) -> Content:
    """Return room i of n on a ring, with a heater."""
    before, after = f"room_{(i - 1) % n}", f"room_{(i + 1) % n}"
    own = f"({1 - 2 * eta - 0.022!r} - 0.05*heater)*warmth"
    return {
        "name": f"room_{i}",
        "states": ["warmth"],
        "inputs": ["heater"],
        "dynamics": [f"{own} + {eta}*({before}.warmth + {after}.warmth) + 2.5*heater - 0.022"],
        "communicated": [before, after],
        "noise_covariance": [[variance]],
        "state_low": [19.0],
        "state_high": [21.0],
        "input_low": [0.0],
        "input_high": [1.0],
        "initial_state": [20.0],
    }


def chains() -> list[Entry]:
    """Return agents that nothing couples and nothing moves."""
    entries = []
    for n, seconds in ((2, 1.4), (10, 1107.0), (20, None)):
        agent = {
            "name": "agent", "copies": n, "A": [[0.8]], "B": [[0.0]], "noise_covariance": [[0.2]],
            "state_low": [-1.0], "state_high": [1.0], "input_low": [0.0], "input_high": [0.0], "initial_state": [0.0],
        }  # fmt: skip
        safe = {"safe": {"agent": "agent_*", "low": [-1.0], "high": [1.0]}}
        task = problem(f"decoupled-{n}", 6, [agent], safe, "G all(safe)", "finite-trace")
        exact = 0.626213**n
        known = {} if seconds is None else {"tool": "SReachTools", "seconds": seconds, "machine": "its 2020 report"}
        note = f"box of 1, variance .2; each agent stays with probability .626213, all with {exact:.4g}"
        entries.append({"content": task, "note": note, **known})
    return entries


def thousand() -> list[Entry]:
    """Return a thousand such agents in a box in which that many stay with a probability that is worth a number."""
    agent = {
        "name": "agent", "copies": 1000, "A": [[0.8]], "B": [[0.0]], "noise_covariance": [[0.2]],
        "state_low": [-4.0], "state_high": [4.0], "input_low": [0.0], "input_high": [0.0], "initial_state": [0.0],
    }  # fmt: skip
    safe = {"safe": {"agent": "agent_*", "low": [-4.0], "high": [4.0]}}
    task = problem("decoupled-1000", 6, [agent], safe, "G all(safe)", "finite-trace")
    note = "a box of 4, which is ours; in the box of 1 all stay with 1e-203"
    return [{"content": task, "note": note, "relation": "boxes", "cells": 40}]


def two_heaters() -> list[Entry]:
    """Return three and five rooms with two heaters, as one agent whose inputs multiply states.

    Five states are more than a grid holds: heaters that are held at one power leave a linear system, whose probability
    is that of a policy of the system in question, and so a lower bound for it.
    """
    n, eta, held = 3, 0.2, 0.75
    heat = "{inside} + h{i}*(2.5 - 0.05*r{i})"
    inside = [f"{1 - 2 * eta - 0.022!r}*r{i} + {eta}*(r{(i - 1) % n} + r{(i + 1) % n}) - 0.022" for i in range(n)]
    three = {
        "name": "house", "states": ["r0", "r1", "r2"], "inputs": ["h0", "h2"],
        "dynamics": [text if i == 1 else heat.format(i=i, inside=text) for i, text in enumerate(inside)],
        **_house(n, 0.02, [20.7, 20.8, 20.7], [0.0, 0.0], [1.0, 1.0]),
    }  # fmt: skip
    note = "from (20.7, 20.8, 20.7), which was looked for; published with a noise of 0 (see the audit)"
    known = {"tool": IMPACT, "machine": REPORT}
    rows = [{"content": _comfort("rooms-3-two-heaters", three), "note": note, "seconds": 80.0, **known, **linear(20)}]
    n, eta, heated = 5, 0.3, (0, 2)
    A = [[eta if (i - j) % n in (1, n - 1) else 0.0 for j in range(n)] for i in range(n)]
    for i in range(n):
        A[i][i] = 1 - 2 * eta - 0.022 - (0.05 * held if i in heated else 0.0)
    five = {
        "name": "house", "A": A, "B": [[0.0]] * n,
        "offset": [-0.022 + (2.5 * held if i in heated else 0.0) for i in range(n)],
        **_house(n, 0.01, [20.85, 20.15, 20.85, 19.45, 19.45], [0.0], [0.0]),
    }  # fmt: skip
    note = f"heaters held at {held}, which makes the system linear; published with a noise of 0 (see the audit)"
    return [*rows, {"content": _comfort("rooms-5-two-heaters", five), "note": note, "seconds": 169.2, **known}]


def _house(n: int, variance: float, start: list[float], low: list[float], high: list[float]) -> Content:
    """Return noise, boxes and start of n rooms."""
    covariance = [[variance if i == j else 0.0 for j in range(n)] for i in range(n)]
    box = {"state_low": [19.0] * n, "state_high": [21.0] * n, "input_low": low, "input_high": high}
    return {"noise_covariance": covariance, **box, "initial_state": start}


def _comfort(name: str, house: Content) -> Content:
    """Return the problem of staying comfortable for eight steps."""
    n = len(house["initial_state"])
    comfort = {"comfort": {"agent": "house", "low": [19.0] * n, "high": [21.0] * n}}
    return problem(name, 8, [house], comfort, "G comfort", "finite-trace")


def entries() -> list[Entry]:
    """Return all of these rows."""
    groups = (deliveries, parkings, patrols, oscillators, cars, integrators, rooms, two_heaters, chains, thousand)
    return [entry for group in groups for entry in group()]
