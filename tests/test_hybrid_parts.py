"""Scan, memory, clusters and reset maps, each by its mathematics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jaxsr._progress import as_budget
from jaxsr._result import InputError
from jaxsr.discovery.find import Task
from jaxsr.discovery.hybrid.clusters import build_clusters, choose_coordinates, split_place
from jaxsr.discovery.hybrid.memory import (
    FunctionMemory,
    continuations,
    harmonics,
    independent_columns,
)
from jaxsr.discovery.hybrid.resets import cut_at, find_resets, jump_places
from jaxsr.discovery.hybrid.scan import best_splits
from jaxsr.discovery.hybrid.submodels import Limits, find_submodel
from jaxsr.discovery.hybrid.tree import meeting_point, refined_threshold
from jaxsr.discovery.samples import roles, samples
from jaxsr.expressions import parse, to_numpy, to_text
from jaxsr.expressions.editing import ONE
from jaxsr.recordings import Recording


def _columns(x: np.ndarray) -> np.ndarray:
    columns = np.column_stack([np.ones_like(x), x, x**2])
    return columns / np.sqrt(np.mean(columns**2, axis=0))


def test_the_scan_places_a_threshold_where_two_fits_leave_least() -> None:
    rng = np.random.default_rng(0)
    x, other = rng.uniform(-1.0, 2.0, (2, 600))
    y = np.where(x > 0.7, 3.0 - x, 2.0 * x) + 1e-3 * rng.normal(size=600)
    first, second = best_splits(_columns(x), y[:, None], [other, x], 10)
    assert first.guard == 1 and second.guard == 0
    below, above = np.sort(x[x <= 0.7])[-1], np.sort(x[x > 0.7])[0]
    assert first.threshold == pytest.approx(0.5 * (below + above), abs=0.01)
    assert first.gain > 5.0 and first.sharpness > 1.0
    assert first.below + first.above == 600


def test_a_smooth_law_has_no_sharp_threshold() -> None:
    x = np.linspace(0.0, 3.0, 600)
    split = best_splits(_columns(x), np.sin(2.0 * x)[:, None], [x], 10)[0]
    assert split.gain > 1.0  # two parabolas are better than one
    assert split.sharpness < 1.0


def test_a_refined_threshold_lies_between_the_last_and_the_first_sample_of_two_laws() -> None:
    x = np.linspace(0.0, 1.0, 101)
    y = np.where(x > 0.405, 1.0 + x, x**2)
    found = refined_threshold(x, y - x**2, y - 1.0 - x, 0.45, 20)
    assert found == pytest.approx(0.405)
    assert refined_threshold(x, y - x**2, y - 1.0 - x, 0.95, 5) > 0.85  # no further than told


def test_laws_that_join_tell_their_guard_between_two_samples() -> None:
    """A contact's force begins at zero: the line through it finds the place; a jump does not."""
    x = np.random.default_rng(3).uniform(-1.0, 1.0, 400)
    contact = 50.0 * (x - 0.1234)
    coarse = 0.1234 + 0.4 * float(np.min(np.abs(x - 0.1234)))
    assert meeting_point(x, contact, coarse) == pytest.approx(0.1234, abs=1e-12)
    assert meeting_point(x, contact + 3.0, coarse) == coarse
    smooth = 80.0 * (x - 0.1234) ** 2
    assert meeting_point(x, smooth, coarse) == pytest.approx(0.1234, abs=1e-9)
    assert meeting_point(x, smooth + 0.1, coarse) == coarse
    assert meeting_point(x, contact + np.sin(400.0 * x), coarse) == coarse


def test_a_cluster_with_an_event_is_parted_by_local_means() -> None:
    rng = np.random.default_rng(1)
    key = rng.permutation(np.linspace(0.0, 1.0, 100))
    error = np.where(key > 0.8, 0.5, 0.0) + 0.01 * rng.normal(size=100)
    place, share = split_place(error, key)
    assert place == pytest.approx(0.8, abs=0.02) and share > 0.9


def test_terms_are_remembered_in_every_form_that_is_the_same_for_one_sign() -> None:
    v = np.linspace(0.5, 2.0, 20)
    term = parse("exp(-3*v)", ("v",))
    forms = continuations(term, ["v"])
    texts = {to_text(form) for form in forms}
    assert {"exp(-3.0*v)", "exp(-3.0*Abs(v))"} <= texts and len(texts) == 3
    for form in forms:
        assert to_numpy(form)({"v": v}) == pytest.approx(to_numpy(term)({"v": v}))
        mirrored = to_numpy(form)({"v": -v})
        assert np.all(np.isfinite(mirrored))
    assert [to_text(f) for f in continuations(parse("1"), ["v"])] == ["1.0", "sign(v)"]


def test_a_product_of_sine_and_cosine_suggests_the_doubled_frequency() -> None:
    texts = [to_text(term) for term in harmonics([parse("sin(t)*cos(t)", ("t",))], "t")]
    assert "sin(2.0*t)" in texts and "cos(t)" in texts


def test_columns_that_others_give_are_left_out() -> None:
    x = np.linspace(1.0, 2.0, 50)
    terms = [parse(text, ("x",)) for text in ("1", "x", "2*x + 1", "Abs(x)", "x**2")]
    kept, columns = independent_columns(terms, {"x": x}, 10)
    assert [to_text(t) for t in kept] == ["1.0", "x", "x**2"]
    assert np.mean(columns**2, axis=0) == pytest.approx(1.0)


def test_clusters_hold_the_nearest_samples_and_are_purest_in_the_state_that_switches() -> None:
    rng = np.random.default_rng(2)
    x, v = rng.uniform(-1.0, 1.0, (2, 400))
    variables = {"t": np.arange(400.0), "x": x, "v": v}
    group = np.repeat([0, 1], 200)
    columns = np.column_stack([np.ones(400), x, v])
    y = np.where(np.abs(v) > 0.4, 2.0 * x - v, -3.0 * x + 1.0)[:, None]
    clusters, errors = choose_coordinates(
        variables, group, [("x", "v"), ("x",), ("v",)], 30, (columns, y)
    )
    assert clusters.coordinates == ("v",) and len(clusters) == len(errors)
    assert np.median(errors) < 1e-6
    centre = clusters.centroids[0, 0]
    nearest = np.sort(np.argsort(np.abs(v - centre))[:30])
    assert np.array_equal(np.sort(clusters.members[0]), nearest)
    assert clusters.nearest({"v": np.array([centre, centre + 1.0])}).shape == (len(clusters), 2)
    with pytest.raises(InputError, match="clusters of 500 from 400"):
        build_clusters(variables, group, ["x"], 500)


def _bounces(factor: float = 0.7) -> Recording:
    """A ball without drag, in closed form between impacts."""
    t, x, v = np.arange(0.0, 2.0, 0.004), [], []
    start, height, speed = 0.0, 1.0, 0.0
    for time in t:
        while True:
            s = time - start
            if height + speed * s - 4.905 * s * s >= 0.0 or s == 0.0:
                break
            hit = (speed + np.sqrt(speed**2 + 19.62 * height)) / 9.81
            start, height, speed = start + hit, 0.0, factor * (9.81 * hit - speed)
        x.append(height + speed * s - 4.905 * s * s)
        v.append(speed - 9.81 * s)
    return Recording("ball", t, {"x": np.array(x), "v": np.array(v)})


def test_jumps_of_a_velocity_give_the_reset_map_and_its_place() -> None:
    ball = _bounces()
    resets = find_resets([ball], roles(["x", "v"], None, 1, [], None))
    assert len(resets) == 1
    reset = resets[0]
    assert (reset.state, reset.place, reset.direction) == ("v", "x", -1)
    assert reset.factor == pytest.approx(-0.7, abs=1e-6) and reset.offset == 0.0
    assert reset.event.when == "x" and set(reset.event.reset) == {"v"}
    pieces = cut_at([ball], resets)
    assert len(pieces) > reset.jumps - 2
    for piece in pieces:
        assert piece.name == "ball"
        assert not len(jump_places(piece.channel("v")))
        assert np.ptp(np.gradient(piece.channel("v"), piece.time)) < 1e-6


def test_smooth_and_square_signals_have_no_resets() -> None:
    t = np.linspace(0.0, 20.0, 1000)
    part = roles(["x", "v"], None, 1, [], None)
    assert not find_resets([Recording("a", t, {"x": np.sin(t), "v": np.cos(t)})], part)
    rng = np.random.default_rng(3)
    square = np.sign(np.sin(t)) * (1.0 + 0.3 * rng.normal(size=1000).cumsum() / 30.0)
    wild = {"x": rng.normal(size=1000).cumsum(), "v": square}
    assert not find_resets([Recording("a", t, wild)], part)


def test_an_autonomous_submodel_is_not_continued_to_negative_time() -> None:
    """A constant is a sign wherever a variable keeps its own, and time always does."""
    t = np.linspace(0.1, 1.0, 60)
    x = 1.0 + np.sin(t)
    channels = {"x": x, "dx": 2.0 - x**2}
    part = replace(roles(["x"], ["dx"], 1, [], None), autonomous=True)
    data = samples([Recording("a", t, channels)], part)
    memory, rows = FunctionMemory({parse("x"): None}), [np.arange(40)]
    task = Task("x", "t", autonomous=True)
    law, explained = find_submodel(
        np.random.default_rng(0), task, memory, data, data, rows, Limits(2), as_budget(None)
    )
    assert explained and {part.term for part in law.terms} == {ONE, parse("x**2")}
    assert all("t" not in term.variables for term in memory)
