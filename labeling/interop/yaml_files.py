"""Reading YAML of any origin: no object is made but plain values, and what aliases expand to is bounded.

An alias stands for a whole value, so nine lines of nine aliases each stand for 400 million values. What the settings
mean is up to the caller.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from ...tracker.errors import LabelError, reason

# The settings of a DeepLabCut project with a thousand videos have 0.2 MB; reading takes about 5 s for each MB.
_MAX_BYTES = 2**20
_MAX_VALUES = 200_000


def read_yaml(path: Path) -> Any:
    """Read a YAML file into plain values.

    Parameters
    ----------
    path : Path
        The file, in UTF-8.

    Returns
    -------
    Any
        Nested dicts and lists of texts, numbers, dates, bools and None.

    Raises
    ------
    LabelError
        The file is too large, is no YAML, names a type of a programming language, or expands to too many values.
    OSError
        The file cannot be read.
    """
    size = path.stat().st_size
    if size > _MAX_BYTES:
        raise LabelError(
            f"{path}: expected settings of at most {_MAX_BYTES / 1e6:.0f} MB, got {size / 1e6:.1f} MB"
        )
    try:
        loader = yaml.SafeLoader(path.read_bytes().decode("utf-8-sig"))
        try:
            node = loader.get_single_node()
            if node is None:
                return None
            _expanded(node, {}, set())
            return loader.construct_document(node)
        finally:
            loader.dispose()
    except RecursionError as error:
        raise LabelError(f"{path}: expected YAML, got one nested too deep") from error
    except yaml.YAMLError as error:
        raise LabelError(
            f"{path}: expected YAML, got a mistake: {' '.join(str(error).split())[:300]}"
        ) from error
    except (
        ValueError,
        OverflowError,
        TypeError,
        AttributeError,
        KeyError,
    ) as error:  # dates and numbers that are none
        raise LabelError(f"{path}: expected YAML, got a mistake: {reason(error)}") from error


def _expanded(node: yaml.Node, sizes: dict[int, int], open_nodes: set[int]) -> int:
    """Return the number of values that a node stands for with its aliases written out.

    Raises
    ------
    ValueError
        They are too many, or a value contains itself.
    """
    key = id(node)
    if key in sizes:
        return sizes[key]
    if key in open_nodes:
        raise ValueError("a value contains itself")
    open_nodes.add(key)
    children: list[yaml.Node] = []
    if isinstance(node, yaml.SequenceNode):
        children = node.value
    elif isinstance(node, yaml.MappingNode):
        children = [child for pair in node.value for child in pair]
    size = 1
    for child in children:
        size += _expanded(child, sizes, open_nodes)
        if size > _MAX_VALUES:
            raise ValueError(f"expected at most {_MAX_VALUES} values, got more by aliases")
    open_nodes.discard(key)
    sizes[key] = size
    return size
