"""What only arranges elements: NumPy puts every number where JAX puts it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxsr.models.jaxpr_arranging import _PLAIN, arranged

RNG = np.random.default_rng(0)
PROGRAMS = {
    "slice": lambda a: jax.lax.slice(a, (1, 0, 2), (4, 3, 5), (2, 1, 3)),
    "squeeze": lambda a: jax.lax.squeeze(a[:, :1, :1], (1, 2)),
    "reshape": lambda a: a.reshape(3, -1),
    "transpose": lambda a: a.transpose(2, 0, 1),
    "rev": lambda a: a[::-1, :, ::-1],
    "concatenate": lambda a: jnp.concatenate([a, a[:, :2]], axis=1),
    "broadcast_in_dim": lambda a: jnp.broadcast_to(a[:, None], (4, 2, 3, 5)),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_elements_lie_where_jax_puts_them(name: str) -> None:
    given = RNG.permutation(60).reshape(4, 3, 5)
    equations = jax.make_jaxpr(PROGRAMS[name])(given).eqns
    assert name in {equation.primitive.name for equation in equations}
    for equation in equations:
        if equation.primitive.name in _PLAIN:
            own = [RNG.permutation(a.aval.size).reshape(a.aval.shape) for a in equation.invars]
            theirs = equation.primitive.bind(*own, **equation.params)
            (ours,) = arranged(equation, own)
            assert np.array_equal(ours, theirs)
            assert ours.shape == equation.outvars[0].aval.shape


def test_every_one_is_tried() -> None:
    assert set(_PLAIN) == set(PROGRAMS)
