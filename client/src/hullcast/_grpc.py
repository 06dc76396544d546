"""gRPC, without its own lines on standard error.

By default gRPC writes lines such as "Handshake failed with error SSL_ERROR_SSL" to standard error.
The exceptions of this package say the same, and name the remedy. gRPC reads the environment
variable GRPC_VERBOSITY when it is first used, so the default has to be set before that.
"""

from __future__ import annotations

import os

os.environ.setdefault("GRPC_VERBOSITY", "ERROR")

import grpc

__all__ = ["grpc"]
