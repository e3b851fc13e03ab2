"""A plant that no simulation follows for long: a pendulum that begins upside down."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.generality.engines import by_diagnosis
from benchmarks.generality.plan import Ticket
from benchmarks.generality.running import made


@pytest.mark.slow
def test_friction_of_a_cart_whose_pendulum_falls_over_is_no_doubt(tmp_path: Path) -> None:
    ticket = Ticket("cart_pendulum-000-rates-friction", "cart_pendulum", "rates", "friction")
    name = made(ticket, 5, tmp_path)
    found = by_diagnosis(tmp_path / "cases" / name, 120.0)
    assert found["verdict"] == "structure"
    assert found["findings"][0]["site"] == "equation:v"
    assert found["findings"][0]["family"] == "dissipative"
