"""The decision by evidence: when it stands, and what it hands to the report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest

from jaxsr._clock import now
from jaxsr._progress import Budget
from jaxsr._result import Verdict
from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis import settled as module
from jaxsr.diagnosis.judging.weights import Weights
from jaxsr.diagnosis.likelihood.posterior import Posterior
from jaxsr.diagnosis.settled import beyond_doubt, weights_of
from jaxsr.models import Simulator, parse_model
from tests.test_likelihood_search import MODEL, recorded


@dataclass(frozen=True)
class Named:
    """A candidate of which only label and verdict count."""

    label: str
    verdict: Verdict = Verdict.STRUCTURE


@dataclass(frozen=True)
class Weighed:
    """A hypothesis of which only members, convergence and latent force count."""

    members: tuple[int, ...]
    settled: bool = True
    share: float = 0.0


@dataclass(frozen=True)
class Estimated:
    """An entry of which only the members count."""

    members: tuple[int, ...]


CANDIDATES = (Named("a@x"), Named("a@x"), Named("b@x"), Named("c@y", Verdict.MEASUREMENT))


def found(hypotheses: list[Weighed], probabilities: list[float], finished: bool = True) -> Any:
    every = cast("Any", (CANDIDATES, tuple(hypotheses), np.array(probabilities)))
    return Posterior(*every, finished=finished)


def test_variants_of_one_set_share_their_probability() -> None:
    mass = weights_of(found([Weighed((0,)), Weighed((1,)), Weighed(())], [0.6, 0.3, 0.1])).of
    assert mass == {frozenset({"a@x"}): pytest.approx(0.9), frozenset(): pytest.approx(0.1)}


def test_what_leaves_doubt_about_the_verdict_is_not_decided() -> None:
    clear = found([Weighed((0,)), Weighed(())], [0.95, 0.05])
    assert beyond_doubt(clear)
    assert not beyond_doubt(replace(clear, finished=False))
    assert not beyond_doubt(found([Weighed((0,)), Weighed(())], [0.7, 0.3]))
    assert not beyond_doubt(found([Weighed((0,)), Weighed((3,)), Weighed(())], [0.7, 0.3, 0.0]))
    assert not beyond_doubt(found([Weighed((0,), False), Weighed(())], [0.95, 0.05]))
    # another mechanism, or one more beside it, is the same verdict
    assert beyond_doubt(found([Weighed((0,)), Weighed((2,)), Weighed(())], [0.5, 0.45, 0.05]))
    assert beyond_doubt(found([Weighed((0,)), Weighed((0, 2)), Weighed(())], [0.5, 0.45, 0.05]))
    assert not beyond_doubt(found([Weighed((0,)), Weighed((0, 3)), Weighed(())], [0.7, 0.3, 0.0]))
    assert beyond_doubt(found([Weighed(()), Weighed((0,))], [0.95, 0.05]))


def test_a_force_that_is_there_for_sure_beside_the_answer_leaves_doubt_unless_it_is_little() -> (
    None
):
    def left(share: float, something_else: float) -> bool:
        sets = [Weighed((0,), share=share), Weighed((), share=0.1)]
        return beyond_doubt(replace(found(sets, [0.95, 0.05]), something_else=something_else))

    assert left(0.05, 0.5)
    assert not left(0.05, 0.99)
    assert left(0.005, 0.99)


def test_alternatives_are_sets_with_one_other_member_in_its_place() -> None:
    weights = Weights(
        {
            frozenset({"a@x", "c@y"}): 0.7,
            frozenset({"b@x", "c@y"}): 0.2,
            frozenset({"a@x"}): 0.06,
            frozenset(): 0.04,
        }
    )
    chosen = Estimated((0, 3))
    entries = [chosen, Estimated((2, 3)), Estimated((0,)), Estimated(())]
    model = cast("Any", type("M", (), {"candidates": CANDIDATES}))
    probability, others = weights.alternatives(model, cast("Any", chosen), 0, cast("Any", entries))
    assert probability == pytest.approx(0.76)
    assert [(a.number, a.probability) for a in others] == [(2, 0.2)]


def _never(*args: object) -> None:
    raise AssertionError("the contest was asked")


@pytest.mark.parametrize(
    ("force", "k", "verdict", "mechanism"),
    [
        (lambda q, v: -0.5 * v * abs(v), 6.0, "structure", "quadratic_drag"),
        (lambda q, v: 0.0, 9.0, "parameter", "wrong_value"),
        (lambda q, v: 0.0, 6.0, "nothing", None),
    ],
)
def test_the_evidence_decides_without_a_contest(
    monkeypatch: pytest.MonkeyPatch, force: Any, k: float, verdict: str, mechanism: str | None
) -> None:
    import importlib

    monkeypatch.setattr(
        importlib.import_module("jaxsr.diagnosis.diagnose"), "decided_among_few", _never
    )
    rng = np.random.default_rng(2)
    runs = [recorded(rng, force, k) for _ in range(2)]
    document = diagnose(Simulator(parse_model(MODEL)), runs, budget=600.0).document
    assert document["verdict"] == verdict
    first = document["findings"][0]["mechanism"] if document["findings"] else None
    assert first == mechanism
    assert not document["provenance"].get("open")


def test_the_start_of_the_program_takes_nothing_of_the_search(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What is slow to read is slow to report; what the interpreter took to load is neither."""
    import importlib

    class Seen(BaseException):
        pass

    def see(case: Any) -> None:
        raise Seen(case)

    monkeypatch.setattr(importlib.import_module("jaxsr.diagnosis.diagnose"), "decided_clearly", see)
    run = recorded(np.random.default_rng(2), lambda q, v: 0.0)
    with pytest.raises(Seen) as seen:
        diagnose(Simulator(parse_model(MODEL)), [run], budget=Budget(1000.0, now() - 400.0))
    assert seen.value.args[0].search.remaining > 100.0


def test_a_model_with_events_is_left_to_the_contest() -> None:
    model = parse_model(MODEL + '[[events]]\nwhen = "q"\nreset = { v = "-v" }\n')
    case = cast("Any", type("C", (), {"simulator": Simulator(model)}))
    assert module.weighed(case) is None
