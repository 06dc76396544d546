from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class GetServerInfoRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class GetServerInfoResponse(_message.Message):
    __slots__ = ("version", "limits", "instruction_set", "compute_threads", "memory_parts", "contract")
    VERSION_FIELD_NUMBER: _ClassVar[int]
    LIMITS_FIELD_NUMBER: _ClassVar[int]
    INSTRUCTION_SET_FIELD_NUMBER: _ClassVar[int]
    COMPUTE_THREADS_FIELD_NUMBER: _ClassVar[int]
    MEMORY_PARTS_FIELD_NUMBER: _ClassVar[int]
    CONTRACT_FIELD_NUMBER: _ClassVar[int]
    version: str
    limits: Limits
    instruction_set: str
    compute_threads: int
    memory_parts: _containers.RepeatedCompositeFieldContainer[MemoryPart]
    contract: int
    def __init__(self, version: _Optional[str] = ..., limits: _Optional[_Union[Limits, _Mapping]] = ..., instruction_set: _Optional[str] = ..., compute_threads: _Optional[int] = ..., memory_parts: _Optional[_Iterable[_Union[MemoryPart, _Mapping]]] = ..., contract: _Optional[int] = ...) -> None: ...

class MemoryPart(_message.Message):
    __slots__ = ("name", "bytes", "max_bytes")
    NAME_FIELD_NUMBER: _ClassVar[int]
    BYTES_FIELD_NUMBER: _ClassVar[int]
    MAX_BYTES_FIELD_NUMBER: _ClassVar[int]
    name: str
    bytes: int
    max_bytes: int
    def __init__(self, name: _Optional[str] = ..., bytes: _Optional[int] = ..., max_bytes: _Optional[int] = ...) -> None: ...

class Limits(_message.Message):
    __slots__ = ("max_message_bytes", "max_pairs_per_request", "max_bodies_per_request", "max_hulls_per_request", "max_vertices_per_hull", "max_pairs_in_flight", "cache_bytes", "store_bytes", "max_streams_per_connection", "max_page_size", "cache_age_seconds", "max_stream_state_bytes", "max_request_bytes_in_flight", "max_deadline_seconds", "max_connections", "max_points_per_hull", "max_memory_bytes")
    MAX_MESSAGE_BYTES_FIELD_NUMBER: _ClassVar[int]
    MAX_PAIRS_PER_REQUEST_FIELD_NUMBER: _ClassVar[int]
    MAX_BODIES_PER_REQUEST_FIELD_NUMBER: _ClassVar[int]
    MAX_HULLS_PER_REQUEST_FIELD_NUMBER: _ClassVar[int]
    MAX_VERTICES_PER_HULL_FIELD_NUMBER: _ClassVar[int]
    MAX_PAIRS_IN_FLIGHT_FIELD_NUMBER: _ClassVar[int]
    CACHE_BYTES_FIELD_NUMBER: _ClassVar[int]
    STORE_BYTES_FIELD_NUMBER: _ClassVar[int]
    MAX_STREAMS_PER_CONNECTION_FIELD_NUMBER: _ClassVar[int]
    MAX_PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    CACHE_AGE_SECONDS_FIELD_NUMBER: _ClassVar[int]
    MAX_STREAM_STATE_BYTES_FIELD_NUMBER: _ClassVar[int]
    MAX_REQUEST_BYTES_IN_FLIGHT_FIELD_NUMBER: _ClassVar[int]
    MAX_DEADLINE_SECONDS_FIELD_NUMBER: _ClassVar[int]
    MAX_CONNECTIONS_FIELD_NUMBER: _ClassVar[int]
    MAX_POINTS_PER_HULL_FIELD_NUMBER: _ClassVar[int]
    MAX_MEMORY_BYTES_FIELD_NUMBER: _ClassVar[int]
    max_message_bytes: int
    max_pairs_per_request: int
    max_bodies_per_request: int
    max_hulls_per_request: int
    max_vertices_per_hull: int
    max_pairs_in_flight: int
    cache_bytes: int
    store_bytes: int
    max_streams_per_connection: int
    max_page_size: int
    cache_age_seconds: int
    max_stream_state_bytes: int
    max_request_bytes_in_flight: int
    max_deadline_seconds: int
    max_connections: int
    max_points_per_hull: int
    max_memory_bytes: int
    def __init__(self, max_message_bytes: _Optional[int] = ..., max_pairs_per_request: _Optional[int] = ..., max_bodies_per_request: _Optional[int] = ..., max_hulls_per_request: _Optional[int] = ..., max_vertices_per_hull: _Optional[int] = ..., max_pairs_in_flight: _Optional[int] = ..., cache_bytes: _Optional[int] = ..., store_bytes: _Optional[int] = ..., max_streams_per_connection: _Optional[int] = ..., max_page_size: _Optional[int] = ..., cache_age_seconds: _Optional[int] = ..., max_stream_state_bytes: _Optional[int] = ..., max_request_bytes_in_flight: _Optional[int] = ..., max_deadline_seconds: _Optional[int] = ..., max_connections: _Optional[int] = ..., max_points_per_hull: _Optional[int] = ..., max_memory_bytes: _Optional[int] = ...) -> None: ...
