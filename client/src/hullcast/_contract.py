"""Refuses the answers of servers that do not know fields of the request.

A server ignores the fields that it does not know, and would answer another question. Each answer
therefore has the contract number of its server, which rises whenever a field is added that changes
answers.
"""

from __future__ import annotations

from . import _checked, _packed
from ._errors import Unimplemented

#: The number of the first contract with margins of bodies and with motions.
MARGINS = 1


def contract_of(data: bytes) -> int:
    """The contract number of a response; 0 for a server that sends none."""
    return int(_checked.parsed(_packed.QueryContactsResponse.FromString, data).contract)


def too_old(version: str, contract: int, needed: int) -> Unimplemented:
    """The error for a server that does not know a field of the request."""
    return Unimplemented(
        f"the server's version {version} does not know the margins of bodies and their velocities: "
        f"its answers have the contract number {contract}, expected {needed} or more. Update the "
        "server",
        reason="SERVER_TOO_OLD",
    )
