"""What a wrong value does as well needs nothing new."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.gravity_fixed import MACHINES, recordings
from jaxsr.diagnosis.likelihood.posterior import posterior
from jaxsr.diagnosis.thinning import prepare_search
from jaxsr.models import parse_model


@pytest.mark.long
@pytest.mark.parametrize("factor", [0.8, 1.15])
def test_a_thrust_that_is_off_is_its_coefficient_and_no_gain_of_the_input(factor: float) -> None:
    machine = MACHINES["rocket"]
    model = parse_model(machine.text.format(wrong=f"{factor * machine.value:.4g}")).pinned()
    prepared, _ = prepare_search(model, recordings(machine, 3), seconds=np.inf)
    found = posterior(model, prepared)
    assert found is not None
    tried = {found.candidates[i].label for h in found.hypotheses for i in h.members}
    assert "input_gain@input:u" not in tried
    leader = [found.candidates[i].label for i in found.leader.members]
    assert leader == [f"wrong_value@parameter:{machine.coefficient}"]
    assert float(found.probabilities[0]) > 0.95
