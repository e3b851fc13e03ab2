"""Immutable expression trees."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from jaxsr.expressions.primitives import PRIMITIVES, Primitive

CONSTANT = "constant"
VARIABLE = "variable"
BOOLEAN = "boolean"
LARGE = 200
"""Nodes from which on a term may be too deep for walks that call themselves."""
KEPT = 10_000
"""Large terms that are kept for those of the same structure."""


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Term:
    """A node of an expression: a constant, a variable, or a primitive of terms.

    Terms compare and hash by structure; the hash is computed once, so that equal subtrees of a
    population can be shared through a dictionary. Those of more than `LARGE` nodes are kept and
    shared as they are built: they hold so many others that comparing them takes long.

    Attributes
    ----------
    size : int
        Number of nodes.
    operators : int
        Number of inner nodes.
    """

    op: str
    args: tuple[Term, ...] = ()
    name: str = ""
    value: float = 0.0
    size: int = field(init=False, repr=False)
    operators: int = field(init=False, repr=False)
    _hash: int = field(init=False, repr=False)

    def __new__(
        cls, op: str, args: tuple[Term, ...] = (), name: str = "", value: float = 0.0
    ) -> Term:
        return _built(op, args, name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        # The hash of text differs between processes, and a user's function travels along.
        op = PRIMITIVES.get(self.op, self.op)
        return _restored, (op, self.args, self.name, self.value)

    @staticmethod
    def constant(value: float) -> Term:
        """Return a constant."""
        return _built(CONSTANT, (), "", float(value))

    @staticmethod
    def boolean(value: bool) -> Term:
        """Return the constant condition True or False."""
        return _built(BOOLEAN, (), "", float(value))

    @staticmethod
    def variable(name: str) -> Term:
        """Return a variable."""
        return _built(VARIABLE, (), name, 0.0)

    @staticmethod
    def apply(op: str, *args: Term) -> Term:
        """Return primitive `op` of `args`.

        Raises
        ------
        ValueError
            The primitive is unknown or takes another number of arguments.
        """
        primitive = PRIMITIVES.get(op)
        if primitive is None:
            raise ValueError(f"`op` must be a primitive, got {op!r}. Known: {sorted(PRIMITIVES)}")
        if primitive.arity != len(args) and primitive.arity != -1:
            raise ValueError(f"{op} takes {primitive.arity} arguments, got {len(args)}")
        return _built(op, args, "", 0.0)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        if not isinstance(other, Term) or self._hash != other._hash:
            return False
        if (self.op, self.name, self.value) != (other.op, other.name, other.value):
            return False
        if self.size > LARGE:
            return _equal(self, other)
        return self.args == other.args

    @property
    def is_constant(self) -> bool:
        """Whether this node is a number."""
        return self.op == CONSTANT

    @property
    def is_variable(self) -> bool:
        """Whether this node is a variable."""
        return self.op == VARIABLE

    def walk(self) -> Iterator[Term]:
        """Yield every node, parents first."""
        stack: list[Term] = [self]
        while stack:
            node = stack.pop()
            yield node
            stack.extend(reversed(node.args))

    def distinct(self) -> Iterator[Term]:
        """Yield every different subtree once: definitions of a model share a lot of them."""
        seen: set[Term] = {self}
        stack: list[Term] = [self]
        while stack:
            node = stack.pop()
            yield node
            new = [arg for arg in dict.fromkeys(node.args) if arg not in seen]
            seen.update(new)
            stack.extend(reversed(new))

    def upward(self, done: Container[Term] = ()) -> Iterator[Term]:
        """Yield every different subtree that has arguments once, arguments first.

        Walks that call themselves for arguments run out of Python's stack on deep terms; where
        they keep what they found, they can go through a large term in this order beforehand.

        Parameters
        ----------
        done : container of Term
            Subtrees that are passed over, with all that is below them.
        """
        seen: set[Term] = set()
        stack: list[Term] = [self]
        while stack:
            node = stack[-1]
            if not node.args or node in seen or node in done:
                stack.pop()
                continue
            waiting = [a for a in node.args if a.args and a not in seen and a not in done]
            if waiting:
                stack.extend(reversed(waiting))
                continue
            stack.pop()
            seen.add(node)
            yield node

    @property
    def depth(self) -> int:
        """Number of levels below the root."""
        return 1 + max(arg.depth for arg in self.args) if self.args else 0

    @property
    def variables(self) -> frozenset[str]:
        """Names of the variables that occur."""
        return frozenset(node.name for node in self.distinct() if node.is_variable)

    def uses(self, ops: frozenset[str]) -> bool:
        """Whether any of the primitives `ops` occurs."""
        return any(node.op in ops for node in self.distinct())

    def substitute(self, replacements: Mapping[str, Term]) -> Term:
        """Replace variables by terms, all at once."""
        if self.is_variable:
            return replacements.get(self.name, self)
        if not self.args:
            return self
        args = tuple(arg.substitute(replacements) for arg in self.args)
        return self if args == self.args else Term(self.op, args)

    def replace_at(self, index: int, new: Term) -> Term:
        """Replace the node that `walk` yields at position `index`."""
        if index == 0:
            return new
        position = 1
        for i, arg in enumerate(self.args):
            size = arg.size
            if index < position + size:
                changed = arg.replace_at(index - position, new)
                return Term(self.op, (*self.args[:i], changed, *self.args[i + 1 :]))
            position += size
        raise IndexError(f"`index` must be below the size {self.size}, got {index}")


def _equal(first: Term, second: Term) -> bool:
    """Compare large terms node by node, each pair of subtrees once.

    Two terms that share their subtrees can have more nodes than can ever be visited.
    """
    met: set[tuple[int, int]] = set()
    pairs = [(first, second)]
    while pairs:
        a, b = pairs.pop()
        if a is b or (id(a), id(b)) in met:
            continue
        met.add((id(a), id(b)))
        if (a._hash, a.op, a.name, a.value) != (b._hash, b.op, b.name, b.value):
            return False
        if len(a.args) != len(b.args):
            return False
        pairs.extend(zip(a.args, b.args, strict=True))
    return True


class _Draft:
    """A term while its slots are filled; one assignment then makes it an immutable Term."""

    __slots__ = tuple(f.name for f in fields(Term))


_LARGE: dict[tuple[Any, ...], Term] = {}
"""Large terms by their structure, `KEPT` at most."""


def _built(op: str, args: tuple[Term, ...], name: str, value: float) -> Term:
    size, operators = 1, 1 if args else 0
    for arg in args:
        size += arg.size
        operators += arg.operators
    known = _LARGE.get((op, args, name, value)) if size > LARGE else None
    if known is not None:
        return known
    # A frozen class fills its slots through object.__setattr__, which takes four times as long.
    draft: Any = _Draft()
    draft.op = op
    draft.args = args
    draft.name = name
    draft.value = value
    draft._hash = hash((op, args, name, value))
    draft.size = size
    draft.operators = operators
    draft.__class__ = Term
    if size > LARGE:
        if len(_LARGE) >= KEPT:
            _LARGE.clear()
        _LARGE[op, args, name, value] = draft
    return draft


def _restored(op: str | Primitive, args: tuple[Term, ...], name: str, value: float) -> Term:
    return Term(op if isinstance(op, str) else op.name, args, name, value)
