"""Which replicas of a list a client uses: rendezvous hashing (highest random weight).

Each pair of a client's identity and a replica's address has a weight, a hash of both. A client
ranks the replicas by their weights and uses the first k. In this way the clients spread evenly over
the replicas without talking to each other. A replica that leaves the list is replaced only in the
subsets that had it. A new replica enters only the subsets in which its weight is among the k
highest.

Thaler and Ravishankar, "Using name-based mappings to increase hit rates", IEEE/ACM Transactions on
Networking 6(1), 1998, section 3, doi:10.1109/90.663936. Their weights are linear congruential
functions. These are SHA-256, because addresses that differ in one digit need unrelated weights.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Iterable, Sequence
from typing import Any

from . import _arguments
from ._errors import InvalidArgument

#: The size of the subset if the caller gives none; docs/cluster.md gives the reasons. Lists of up
#: to 8 replicas are used as a whole.
DEFAULT = 8
#: The largest subset that can be asked for.
LARGEST = 2**31 - 1
_LONGEST_IDENTITY = 200


def weight(identity: str, address: str) -> int:
    """The weight of a replica for a client: the first 64 bits of a hash of both.

    An identity has no NUL character, so no two pairs hash the same bytes.
    """
    return int.from_bytes(hashlib.sha256(f"{identity}\0{address}".encode()).digest()[:8], "big")


def ranked(identity: str, addresses: Iterable[str]) -> list[str]:
    """The different addresses by falling weight; of equal weights the lower address is first."""
    return sorted(set(addresses), key=lambda address: (-weight(identity, address), address))


def groups(identity: str, addresses: Sequence[str], size: int | None) -> list[tuple[str, ...]]:
    """The groups of replicas that a client uses, one after the other.

    The first group is the client's subset. The next group is used if all replicas of a group are
    down.

    Args:
        identity: the client's identity.
        addresses: the replicas as "host:port".
        size: the size of a group; None for the default.
    """
    size = DEFAULT if size is None else size
    if size >= len(set(addresses)):
        return [tuple(addresses)]
    order = ranked(identity, addresses)
    return [tuple(order[start : start + size]) for start in range(0, len(order), size)]


def random_identity() -> str:
    """An identity that no other client has."""
    return secrets.token_hex(16)


def checked_size(size: Any, *, several: bool) -> int | None:
    """Checks the argument `subset`. None means the default.

    Raises:
        InvalidArgument: WRONG_TYPE, VALUE_OUT_OF_RANGE or CONTRADICTION.
    """
    if size is None:
        return None
    checked = _arguments.integer("subset", size, 1, LARGEST)
    if not several:
        raise InvalidArgument(
            f"got {checked} and one address, expected a list of addresses as target: a subset is "
            "chosen from a list",
            reason="CONTRADICTION",
            field="subset",
        )
    return checked


def checked_identity(identity: Any) -> str | None:
    """Checks the argument `identity`. None means a random one.

    Raises:
        InvalidArgument: WRONG_TYPE or VALUE_OUT_OF_RANGE.
    """
    if identity is None:
        return None
    expected = f"expected 1 to {_LONGEST_IDENTITY} visible ASCII characters, without spaces"
    if not isinstance(identity, str):
        raise InvalidArgument(
            f"got {_arguments.kind(identity)}, {expected}", reason="WRONG_TYPE", field="identity"
        )
    if not 1 <= len(identity) <= _LONGEST_IDENTITY or not all("!" <= c <= "~" for c in identity):
        raise InvalidArgument(
            f"got {_arguments.shown(identity)}, {expected}",
            reason="VALUE_OUT_OF_RANGE",
            field="identity",
        )
    return identity
