from google.protobuf import field_mask_pb2 as _field_mask_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class HullDefinition(_message.Message):
    __slots__ = ("vertices", "contraction_point", "simplification", "planarity")
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    CONTRACTION_POINT_FIELD_NUMBER: _ClassVar[int]
    SIMPLIFICATION_FIELD_NUMBER: _ClassVar[int]
    PLANARITY_FIELD_NUMBER: _ClassVar[int]
    vertices: _containers.RepeatedScalarFieldContainer[float]
    contraction_point: _containers.RepeatedScalarFieldContainer[float]
    simplification: Simplification
    planarity: float
    def __init__(self, vertices: _Optional[_Iterable[float]] = ..., contraction_point: _Optional[_Iterable[float]] = ..., simplification: _Optional[_Union[Simplification, _Mapping]] = ..., planarity: _Optional[float] = ...) -> None: ...

class Simplification(_message.Message):
    __slots__ = ("max_vertices", "max_deviation")
    MAX_VERTICES_FIELD_NUMBER: _ClassVar[int]
    MAX_DEVIATION_FIELD_NUMBER: _ClassVar[int]
    max_vertices: int
    max_deviation: float
    def __init__(self, max_vertices: _Optional[int] = ..., max_deviation: _Optional[float] = ...) -> None: ...

class RegisterHullsRequest(_message.Message):
    __slots__ = ("hulls",)
    HULLS_FIELD_NUMBER: _ClassVar[int]
    hulls: _containers.RepeatedCompositeFieldContainer[HullDefinition]
    def __init__(self, hulls: _Optional[_Iterable[_Union[HullDefinition, _Mapping]]] = ...) -> None: ...

class RegisterHullsResponse(_message.Message):
    __slots__ = ("results", "contract")
    RESULTS_FIELD_NUMBER: _ClassVar[int]
    CONTRACT_FIELD_NUMBER: _ClassVar[int]
    results: _containers.RepeatedCompositeFieldContainer[RegisterHullResult]
    contract: int
    def __init__(self, results: _Optional[_Iterable[_Union[RegisterHullResult, _Mapping]]] = ..., contract: _Optional[int] = ...) -> None: ...

class RegisterHullResult(_message.Message):
    __slots__ = ("hull", "error")
    HULL_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    hull: HullInfo
    error: HullError
    def __init__(self, hull: _Optional[_Union[HullInfo, _Mapping]] = ..., error: _Optional[_Union[HullError, _Mapping]] = ...) -> None: ...

class HullError(_message.Message):
    __slots__ = ("reason", "message", "field", "index")
    REASON_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    FIELD_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    reason: str
    message: str
    field: str
    index: int
    def __init__(self, reason: _Optional[str] = ..., message: _Optional[str] = ..., field: _Optional[str] = ..., index: _Optional[int] = ...) -> None: ...

class HullInfo(_message.Message):
    __slots__ = ("id", "contraction_point", "vertex_count", "face_count", "edge_count", "volume", "center_of_mass", "inertia", "inradius", "circumradius", "geometric_error", "registered_count", "deviation", "planarity")
    ID_FIELD_NUMBER: _ClassVar[int]
    CONTRACTION_POINT_FIELD_NUMBER: _ClassVar[int]
    VERTEX_COUNT_FIELD_NUMBER: _ClassVar[int]
    FACE_COUNT_FIELD_NUMBER: _ClassVar[int]
    EDGE_COUNT_FIELD_NUMBER: _ClassVar[int]
    VOLUME_FIELD_NUMBER: _ClassVar[int]
    CENTER_OF_MASS_FIELD_NUMBER: _ClassVar[int]
    INERTIA_FIELD_NUMBER: _ClassVar[int]
    INRADIUS_FIELD_NUMBER: _ClassVar[int]
    CIRCUMRADIUS_FIELD_NUMBER: _ClassVar[int]
    GEOMETRIC_ERROR_FIELD_NUMBER: _ClassVar[int]
    REGISTERED_COUNT_FIELD_NUMBER: _ClassVar[int]
    DEVIATION_FIELD_NUMBER: _ClassVar[int]
    PLANARITY_FIELD_NUMBER: _ClassVar[int]
    id: bytes
    contraction_point: _containers.RepeatedScalarFieldContainer[float]
    vertex_count: int
    face_count: int
    edge_count: int
    volume: float
    center_of_mass: _containers.RepeatedScalarFieldContainer[float]
    inertia: _containers.RepeatedScalarFieldContainer[float]
    inradius: float
    circumradius: float
    geometric_error: float
    registered_count: int
    deviation: float
    planarity: float
    def __init__(self, id: _Optional[bytes] = ..., contraction_point: _Optional[_Iterable[float]] = ..., vertex_count: _Optional[int] = ..., face_count: _Optional[int] = ..., edge_count: _Optional[int] = ..., volume: _Optional[float] = ..., center_of_mass: _Optional[_Iterable[float]] = ..., inertia: _Optional[_Iterable[float]] = ..., inradius: _Optional[float] = ..., circumradius: _Optional[float] = ..., geometric_error: _Optional[float] = ..., registered_count: _Optional[int] = ..., deviation: _Optional[float] = ..., planarity: _Optional[float] = ...) -> None: ...

class GetHullsRequest(_message.Message):
    __slots__ = ("ids", "field_mask")
    IDS_FIELD_NUMBER: _ClassVar[int]
    FIELD_MASK_FIELD_NUMBER: _ClassVar[int]
    ids: _containers.RepeatedScalarFieldContainer[bytes]
    field_mask: _field_mask_pb2.FieldMask
    def __init__(self, ids: _Optional[_Iterable[bytes]] = ..., field_mask: _Optional[_Union[_field_mask_pb2.FieldMask, _Mapping]] = ...) -> None: ...

class GetHullsResponse(_message.Message):
    __slots__ = ("hulls",)
    HULLS_FIELD_NUMBER: _ClassVar[int]
    hulls: _containers.RepeatedCompositeFieldContainer[HullRecord]
    def __init__(self, hulls: _Optional[_Iterable[_Union[HullRecord, _Mapping]]] = ...) -> None: ...

class HullRecord(_message.Message):
    __slots__ = ("id", "found", "info", "vertices", "vertex_indices", "face_offsets", "face_vertices", "face_normals")
    ID_FIELD_NUMBER: _ClassVar[int]
    FOUND_FIELD_NUMBER: _ClassVar[int]
    INFO_FIELD_NUMBER: _ClassVar[int]
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    VERTEX_INDICES_FIELD_NUMBER: _ClassVar[int]
    FACE_OFFSETS_FIELD_NUMBER: _ClassVar[int]
    FACE_VERTICES_FIELD_NUMBER: _ClassVar[int]
    FACE_NORMALS_FIELD_NUMBER: _ClassVar[int]
    id: bytes
    found: bool
    info: HullInfo
    vertices: _containers.RepeatedScalarFieldContainer[float]
    vertex_indices: _containers.RepeatedScalarFieldContainer[int]
    face_offsets: _containers.RepeatedScalarFieldContainer[int]
    face_vertices: _containers.RepeatedScalarFieldContainer[int]
    face_normals: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, id: _Optional[bytes] = ..., found: bool = ..., info: _Optional[_Union[HullInfo, _Mapping]] = ..., vertices: _Optional[_Iterable[float]] = ..., vertex_indices: _Optional[_Iterable[int]] = ..., face_offsets: _Optional[_Iterable[int]] = ..., face_vertices: _Optional[_Iterable[int]] = ..., face_normals: _Optional[_Iterable[float]] = ...) -> None: ...

class HasHullsRequest(_message.Message):
    __slots__ = ("ids",)
    IDS_FIELD_NUMBER: _ClassVar[int]
    ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class HasHullsResponse(_message.Message):
    __slots__ = ("present",)
    PRESENT_FIELD_NUMBER: _ClassVar[int]
    present: _containers.RepeatedScalarFieldContainer[bool]
    def __init__(self, present: _Optional[_Iterable[bool]] = ...) -> None: ...

class ListHullsRequest(_message.Message):
    __slots__ = ("page_size", "page_token")
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    page_size: int
    page_token: str
    def __init__(self, page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListHullsResponse(_message.Message):
    __slots__ = ("hulls", "next_page_token")
    HULLS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    hulls: _containers.RepeatedCompositeFieldContainer[StoredHull]
    next_page_token: str
    def __init__(self, hulls: _Optional[_Iterable[_Union[StoredHull, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class StoredHull(_message.Message):
    __slots__ = ("id", "created_unix_ms", "bytes")
    ID_FIELD_NUMBER: _ClassVar[int]
    CREATED_UNIX_MS_FIELD_NUMBER: _ClassVar[int]
    BYTES_FIELD_NUMBER: _ClassVar[int]
    id: bytes
    created_unix_ms: int
    bytes: int
    def __init__(self, id: _Optional[bytes] = ..., created_unix_ms: _Optional[int] = ..., bytes: _Optional[int] = ...) -> None: ...

class DeleteHullsRequest(_message.Message):
    __slots__ = ("ids",)
    IDS_FIELD_NUMBER: _ClassVar[int]
    ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class DeleteHullsResponse(_message.Message):
    __slots__ = ("deleted",)
    DELETED_FIELD_NUMBER: _ClassVar[int]
    deleted: _containers.RepeatedScalarFieldContainer[bool]
    def __init__(self, deleted: _Optional[_Iterable[bool]] = ...) -> None: ...
