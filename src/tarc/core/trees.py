"""Trees of arrays: nested NamedTuples, tuples and dicts, packed into one vector and back."""

from collections.abc import Sequence

import numpy as np

from tarc.core.types import Tree, Vector


def leaves(tree: Tree) -> list[Vector]:
    """Return the arrays of a nested NamedTuple, tuple or dict, in order."""
    if isinstance(tree, dict):
        return [leaf for key in tree for leaf in leaves(tree[key])]
    if isinstance(tree, tuple):
        return [leaf for branch in tree for leaf in leaves(branch)]
    return [tree]


def rebuild(tree: Tree, values: Sequence[Vector]) -> Tree:
    """Return a tree of the same structure with other leaves, the inverse of `leaves`."""
    supply = iter(values)

    def build(node: Tree) -> Tree:
        if isinstance(node, dict):
            return {key: build(child) for key, child in node.items()}
        if isinstance(node, tuple):
            children = [build(child) for child in node]
            return type(node)(*children) if hasattr(node, "_fields") else tuple(children)
        return next(supply)

    return build(tree)


def names(tree: Tree, prefix: str = "") -> list[str]:
    """Return the dotted name of each leaf, in the order of `leaves`."""
    if isinstance(tree, dict):
        items = list(tree.items())
    elif isinstance(tree, tuple):
        fields = getattr(tree, "_fields", range(len(tree)))
        items = [(str(field), child) for field, child in zip(fields, tree, strict=True)]
    else:
        return [prefix]
    return [name for key, child in items for name in names(child, f"{prefix}.{key}" if prefix else key)]


def pack(tree: Tree) -> np.ndarray:
    """Return all numbers of a tree as one vector; matrices column by column, as CasADi stores them."""
    parts = [np.ravel(np.asarray(leaf, dtype=float), order="F") for leaf in leaves(tree)]
    return np.concatenate(parts) if parts else np.zeros(0)


def unpack(tree: Tree, vector: np.ndarray) -> Tree:
    """Return a tree of the same shapes with the numbers of a vector, the inverse of `pack`."""
    result, start = [], 0
    for leaf in leaves(tree):
        shape = np.shape(leaf)
        size = int(np.prod(shape))
        result.append(np.reshape(vector[start : start + size], shape, order="F"))
        start += size
    return rebuild(tree, result)
