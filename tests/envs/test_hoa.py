"""HOA texts of terminal deterministic Buchi automata are read exactly; everything else is refused with its reason."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from certigym.envs.tasks.automata.hoa import automaton_from_hoa
from certigym.envs.tasks.automata.translation import translate

AB = ("a", "b")
UNTIL = """HOA: v1
name: "a U b"
States: 2
Start: 1
AP: 2 "a" "b"
acc-name: Buchi
Acceptance: 1 Inf(0)
properties: trans-labels explicit-labels state-acc deterministic
properties: terminal
--BODY--
State: 0 {0}
[t] 0
State: 1
[1] 0
[0&!1] 1
--END--
"""


def test_what_spot_writes_is_read() -> None:
    assert automaton_from_hoa(UNTIL, AB).to_dict() == translate("a U b", AB, "co-safe").to_dict()
    more = automaton_from_hoa(UNTIL, ["c", "b", "a"])
    assert more.to_dict() == translate("a U b", ["c", "b", "a"], "co-safe").to_dict()


VARIANTS = {
    "transition acceptance": UNTIL.replace("State: 0 {0}\n[t] 0", "State: 0\n[t] 0 {0}"),
    "mark on the entering edge too": UNTIL.replace("[1] 0", "[1] 0 {0}"),
    "loop in two parts": UNTIL.replace("[t] 0", "[0] 0 [!0] 0"),
    "aliases": UNTIL.replace("Acceptance", "Alias: @g 1\nAlias: @stay (0 & !@g)\nAcceptance")
    .replace("[1] 0", "[@g] 0")
    .replace("[0&!1]", "[@stay]"),
    "state label": UNTIL.replace("State: 0 {0}\n[t] 0", 'State: [t] 0 "done" {0}\n0'),
    "implicit labels": UNTIL.replace("[t] 0", "0 0 0 0")
    .replace("[1] 0\n[0&!1] 1", "2 1 0 0 State: 2 2 2 2 2")
    .replace("States: 2", "States: 3"),
    "explicit trap": UNTIL.replace("[0&!1] 1", "[0&!1] 1 [!0&!1] 2 State: 2 [t] 2").replace("States: 2\n", ""),
    "unreachable parts": UNTIL.replace("--END--", "State: 7 [0] 1 [!0] 0 [f] 7 --END--").replace(
        "States: 2", "States: 8"
    ),
    "comments": UNTIL.replace("State: 1", '/* a /* nested " */ comment */ State: 1').replace("v1", "v1 /* \n */"),
    "other spacing": " ".join(UNTIL.split()),
    "unknown small headers": UNTIL.replace("tool", "x").replace(
        "acc-name: Buchi", 'controllable-AP: 0 1\ntool: "x" "1"'
    ),
    "operators": UNTIL.replace("[0&!1]", "[!(!0 | 1) & (t | f) & !f]"),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_the_same_automaton_in_other_words(name: str) -> None:
    assert automaton_from_hoa(VARIANTS[name], AB).to_dict() == translate("a U b", AB, "co-safe").to_dict()


def test_acceptance_is_never_late() -> None:
    """Both successors of the start accept, so the task is satisfied from the start."""
    late = UNTIL.replace("[1] 0\n[0&!1] 1", "[1] 0\n[!1] 0")
    assert automaton_from_hoa(late, AB).to_dict() == translate("true", AB, "co-safe").to_dict()


REFUSED = {
    "not terminal": (UNTIL.replace("[t] 0", "[0] 0 [!0] 1"), "state 0 has an accepting mark that does not lead"),
    "mark on a loop that can be left": (UNTIL.replace("[0&!1] 1", "[0&!1] 1 {0}"), "state 1 has an accepting mark"),
    "incomplete acceptance": (UNTIL.replace("[t] 0", "[0] 0"), "not terminal"),
    "half marked": (UNTIL.replace("State: 0 {0}\n[t] 0", "State: 0\n[0] 0 {0} [!0] 0"), "not terminal"),
    "co-Buchi": (UNTIL.replace("Inf(0)", "Fin(0)"), "expected Buchi acceptance, .* got 1 Fin"),
    "generalised": (UNTIL.replace("1 Inf(0)", "2 Inf(0)&Inf(1)"), "expected Buchi acceptance"),
    "complemented": (UNTIL.replace("Inf(0)", "Inf(!0)"), "expected Buchi acceptance"),
    "trivial": (UNTIL.replace("1 Inf(0)", "0 t"), "expected Buchi acceptance"),
    "no acceptance": (UNTIL.replace("Acceptance: 1 Inf(0)\n", ""), "got none"),
    "second set": (UNTIL.replace("{0}", "{0 1}"), "acceptance set 0 only, got 1"),
    "non-deterministic": (UNTIL.replace("[0&!1]", "[0]"), "state 1 has edges to different states on the letter a & b"),
    "two starts": (UNTIL.replace("Start: 1", "Start: 1\nStart: 0"), "one initial state"),
    "alternating start": (UNTIL.replace("Start: 1", "Start: 1&0"), "one initial state"),
    "alternating edge": (UNTIL.replace("[1] 0", "[1] 0&1"), "line 14: .*alternation"),
    "proposition twice": (UNTIL.replace('"b"', '"a"'), "different atomic propositions"),
    "label out of range": (UNTIL.replace("[1]", "[2]"), "line 14: expected t, f, .* below 2 in a label, got '2'"),
    "deep label": (UNTIL.replace("[1]", "[" + "(" * 1000 + "1"), "nests deeper"),
    "mixed labels": (UNTIL.replace("[1] 0", "0"), "mixes edges|with and without"),
    "too few implicit edges": (UNTIL.replace("[t] 0", "0 0 0"), r"expected 2\^2 edges"),
    "state twice": (UNTIL.replace("State: 1", "State: 0"), "state 0 once"),
    "state out of range": (UNTIL.replace("[1] 0", "[1] 5"), "states below 2, got 5"),
    "capital header": (UNTIL.replace("name:", "Controller:"), "its capital letter says that it matters"),
    "aborted": (UNTIL.replace("--END--", "--ABORT--"), "expected --END--, got '--ABORT--'"),
    "cut off": (UNTIL[: UNTIL.index("[0&")], "expected --END--, got 'the end'"),
    "two automata": (UNTIL + UNTIL, "expected one automaton"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_everything_else_is_refused_with_its_reason(name: str) -> None:
    hoa, message = REFUSED[name]
    with pytest.raises(ValueError, match=message) as caught:
        automaton_from_hoa(hoa, AB)
    assert str(caught.value).startswith("`hoa`") and "\n" not in str(caught.value)


@given(st.data())
def test_damaged_texts_are_read_or_refused(data: st.DataObject) -> None:
    source = data.draw(st.sampled_from([UNTIL, VARIANTS["aliases"], VARIANTS["implicit labels"], VARIANTS["comments"]]))
    pieces = source.split(" ")
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(pieces) - 1))
        pieces[at : at + data.draw(st.integers(0, 2))] = data.draw(
            st.lists(
                st.sampled_from(["0", "1", "[", "]", "{0}", "&", "!", "t", "@g", "State:", "AP:", '"', "9", "é"]),
                max_size=2,
            )
        )
    try:
        automaton = automaton_from_hoa(" ".join(pieces), AB)
    except ValueError as error:
        assert str(error).startswith("`hoa`")
        return
    assert automaton.semantics == "co-safe"
