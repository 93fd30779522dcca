"""Words that somebody wrote, beside those that are known."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence


def close_match(name: str, allowed: Sequence[str]) -> str:
    """A hint for an error message: the nearest allowed name, else the list of them."""
    near = difflib.get_close_matches(name, allowed, n=1)
    return f"did you mean {near[0]!r}?" if near else "expected one of: " + ", ".join(allowed)


def whole_names(parts: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """Names from what stood between commas: known ones, the longest first, may hold commas themselves."""
    found, k = [], 0
    while k < len(parts):
        end = next((e for e in range(len(parts), k, -1) if ",".join(parts[k:e]) in known), k + 1)
        found.append(",".join(parts[k:end]))
        k = end
    return tuple(found)


def suggestion(word: str, candidates: Sequence[str]) -> str:
    """`" (did you mean 'x'?)"` for the nearest candidates, or nothing."""
    folded = {candidate.lower(): candidate for candidate in candidates}
    close = [folded[match] for match in difflib.get_close_matches(word.lower(), list(folded), n=3, cutoff=0.6)]
    return f" (did you mean {' or '.join(repr(name) for name in close)}?)" if close else ""


def shortened(path: object) -> str:
    """A path in a message, its beginning where it is very long."""
    return str(path) if len(str(path)) <= 200 else f"{str(path)[:60]}..."


def check_keys(found: Iterable[str], allowed: Sequence[str], where: object) -> None:
    """Refuse a table's keys that mean nothing.

    Raises
    ------
    ValueError
        One line that says where, and names the first such key and the nearest one that is allowed.
    """
    for key in found:
        if key not in allowed:
            raise ValueError(f"{where}: unknown key {key!r}; {close_match(key, allowed)}")
