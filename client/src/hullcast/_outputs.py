"""The names of the outputs that a query requests."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from . import _arguments
from ._arguments import iterable
from ._errors import InvalidArgument
from ._pb import contacts_pb2
from ._wire import DEFAULT_OUTPUTS


def output_names(outputs: Iterable[str] | None, *, session: bool = False) -> Sequence[str]:
    """The requested outputs, checked and in upper case; the default outputs for None.

    Args:
        outputs: names of outputs, as a caller gave them.
        session: whether they are those of a session; only a session has matches.

    Raises:
        InvalidArgument: WRONG_TYPE, UNKNOWN_VALUE, or SESSION_ONLY for MATCHES.
    """
    if outputs is None:
        return DEFAULT_OUTPUTS
    known = [key.removeprefix("OUTPUT_") for key in contacts_pb2.Output.keys()[1:]]
    given: Any = (outputs,) if isinstance(outputs, str) else outputs
    if isinstance(given, (bytes, Mapping)) or not iterable(given):
        raise InvalidArgument(
            f"expected a list of {', '.join(known)}, got {_arguments.shown(outputs)}",
            reason="WRONG_TYPE",
            field="outputs",
        )
    names: list[str] = []
    for i, name in enumerate(given):  # pyright: ignore[reportUnknownVariableType, reportUnknownArgumentType]
        # Accept the spelling of the command line, "witness-b", too.
        plain = name.upper().replace("-", "_") if isinstance(name, str) else ""
        if plain not in known:
            raise InvalidArgument(
                f"got {_arguments.shown(name)}, expected one of {', '.join(known)}",
                reason="UNKNOWN_VALUE",
                field="outputs",
                index=i,
            )
        if plain == "MATCHES" and not session:
            raise InvalidArgument(
                "got 'MATCHES', which compares a step with the step before: only a session has "
                "it, and hullcast.match compares the answers of two calls",
                reason="SESSION_ONLY",
                field="outputs",
                index=i,
            )
        names.append(plain)
    # On the wire an empty list means the default. Outcomes are always sent.
    return tuple(names) or ("OUTCOME",)
