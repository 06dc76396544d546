from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Solver(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SOLVER_UNSPECIFIED: _ClassVar[Solver]
    SOLVER_PORTAL: _ClassVar[Solver]
    SOLVER_GJK_RAY_CAST: _ClassVar[Solver]

class Output(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OUTPUT_UNSPECIFIED: _ClassVar[Output]
    OUTPUT_OUTCOME: _ClassVar[Output]
    OUTPUT_ALPHA: _ClassVar[Output]
    OUTPUT_NORMAL: _ClassVar[Output]
    OUTPUT_POINTS: _ClassVar[Output]
    OUTPUT_WITNESS_B: _ClassVar[Output]
    OUTPUT_FEATURES: _ClassVar[Output]
    OUTPUT_BASES: _ClassVar[Output]
    OUTPUT_DIAGNOSTICS: _ClassVar[Output]
    OUTPUT_MATCHES: _ClassVar[Output]
    OUTPUT_ALPHA_GRADIENT: _ClassVar[Output]
    OUTPUT_SEPARATION_GRADIENT: _ClassVar[Output]
    OUTPUT_NORMAL_JACOBIAN: _ClassVar[Output]

class Outcome(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    OUTCOME_UNSPECIFIED: _ClassVar[Outcome]
    OUTCOME_CONTACT: _ClassVar[Outcome]
    OUTCOME_SEPARATED: _ClassVar[Outcome]
    OUTCOME_UNDECIDED: _ClassVar[Outcome]
    OUTCOME_INVALID: _ClassVar[Outcome]

class Flag(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FLAG_NONE: _ClassVar[Flag]
    FLAG_ESTIMATED: _ClassVar[Flag]
    FLAG_COINCIDENT: _ClassVar[Flag]
    FLAG_GAP_OPEN: _ClassVar[Flag]
    FLAG_REDUCED: _ClassVar[Flag]
    FLAG_UNKNOWN_HULL: _ClassVar[Flag]
    FLAG_HULL_UNAVAILABLE: _ClassVar[Flag]
    FLAG_INVALID_BODY: _ClassVar[Flag]
    FLAG_KINK: _ClassVar[Flag]

class FeatureKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FEATURE_KIND_NONE: _ClassVar[FeatureKind]
    FEATURE_KIND_VERTEX: _ClassVar[FeatureKind]
    FEATURE_KIND_EDGE: _ClassVar[FeatureKind]
    FEATURE_KIND_FACE: _ClassVar[FeatureKind]
SOLVER_UNSPECIFIED: Solver
SOLVER_PORTAL: Solver
SOLVER_GJK_RAY_CAST: Solver
OUTPUT_UNSPECIFIED: Output
OUTPUT_OUTCOME: Output
OUTPUT_ALPHA: Output
OUTPUT_NORMAL: Output
OUTPUT_POINTS: Output
OUTPUT_WITNESS_B: Output
OUTPUT_FEATURES: Output
OUTPUT_BASES: Output
OUTPUT_DIAGNOSTICS: Output
OUTPUT_MATCHES: Output
OUTPUT_ALPHA_GRADIENT: Output
OUTPUT_SEPARATION_GRADIENT: Output
OUTPUT_NORMAL_JACOBIAN: Output
OUTCOME_UNSPECIFIED: Outcome
OUTCOME_CONTACT: Outcome
OUTCOME_SEPARATED: Outcome
OUTCOME_UNDECIDED: Outcome
OUTCOME_INVALID: Outcome
FLAG_NONE: Flag
FLAG_ESTIMATED: Flag
FLAG_COINCIDENT: Flag
FLAG_GAP_OPEN: Flag
FLAG_REDUCED: Flag
FLAG_UNKNOWN_HULL: Flag
FLAG_HULL_UNAVAILABLE: Flag
FLAG_INVALID_BODY: Flag
FLAG_KINK: Flag
FEATURE_KIND_NONE: FeatureKind
FEATURE_KIND_VERTEX: FeatureKind
FEATURE_KIND_EDGE: FeatureKind
FEATURE_KIND_FACE: FeatureKind

class Accuracy(_message.Message):
    __slots__ = ("solver", "relative_tolerance", "feature_angle", "max_points")
    SOLVER_FIELD_NUMBER: _ClassVar[int]
    RELATIVE_TOLERANCE_FIELD_NUMBER: _ClassVar[int]
    FEATURE_ANGLE_FIELD_NUMBER: _ClassVar[int]
    MAX_POINTS_FIELD_NUMBER: _ClassVar[int]
    solver: Solver
    relative_tolerance: float
    feature_angle: float
    max_points: int
    def __init__(self, solver: _Optional[_Union[Solver, str]] = ..., relative_tolerance: _Optional[float] = ..., feature_angle: _Optional[float] = ..., max_points: _Optional[int] = ...) -> None: ...

class QueryContactsRequest(_message.Message):
    __slots__ = ("request_id", "inherit", "hull_ids", "body_hulls", "positions", "rotations", "pairs", "worlds", "groups", "ignored_groups", "margin", "accuracy", "outputs", "warm_starts", "find", "moved", "margins", "linear_velocities", "angular_velocities", "time_step", "turning_points", "previous_bodies")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    INHERIT_FIELD_NUMBER: _ClassVar[int]
    HULL_IDS_FIELD_NUMBER: _ClassVar[int]
    BODY_HULLS_FIELD_NUMBER: _ClassVar[int]
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    ROTATIONS_FIELD_NUMBER: _ClassVar[int]
    PAIRS_FIELD_NUMBER: _ClassVar[int]
    WORLDS_FIELD_NUMBER: _ClassVar[int]
    GROUPS_FIELD_NUMBER: _ClassVar[int]
    IGNORED_GROUPS_FIELD_NUMBER: _ClassVar[int]
    MARGIN_FIELD_NUMBER: _ClassVar[int]
    ACCURACY_FIELD_NUMBER: _ClassVar[int]
    OUTPUTS_FIELD_NUMBER: _ClassVar[int]
    WARM_STARTS_FIELD_NUMBER: _ClassVar[int]
    FIND_FIELD_NUMBER: _ClassVar[int]
    MOVED_FIELD_NUMBER: _ClassVar[int]
    MARGINS_FIELD_NUMBER: _ClassVar[int]
    LINEAR_VELOCITIES_FIELD_NUMBER: _ClassVar[int]
    ANGULAR_VELOCITIES_FIELD_NUMBER: _ClassVar[int]
    TIME_STEP_FIELD_NUMBER: _ClassVar[int]
    TURNING_POINTS_FIELD_NUMBER: _ClassVar[int]
    PREVIOUS_BODIES_FIELD_NUMBER: _ClassVar[int]
    request_id: int
    inherit: bool
    hull_ids: _containers.RepeatedScalarFieldContainer[bytes]
    body_hulls: _containers.RepeatedScalarFieldContainer[int]
    positions: _containers.RepeatedScalarFieldContainer[float]
    rotations: _containers.RepeatedScalarFieldContainer[float]
    pairs: _containers.RepeatedScalarFieldContainer[int]
    worlds: _containers.RepeatedScalarFieldContainer[int]
    groups: _containers.RepeatedScalarFieldContainer[int]
    ignored_groups: _containers.RepeatedScalarFieldContainer[int]
    margin: float
    accuracy: Accuracy
    outputs: _containers.RepeatedScalarFieldContainer[Output]
    warm_starts: _containers.RepeatedScalarFieldContainer[int]
    find: bool
    moved: _containers.RepeatedScalarFieldContainer[int]
    margins: _containers.RepeatedScalarFieldContainer[float]
    linear_velocities: _containers.RepeatedScalarFieldContainer[float]
    angular_velocities: _containers.RepeatedScalarFieldContainer[float]
    time_step: float
    turning_points: _containers.RepeatedScalarFieldContainer[float]
    previous_bodies: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, request_id: _Optional[int] = ..., inherit: bool = ..., hull_ids: _Optional[_Iterable[bytes]] = ..., body_hulls: _Optional[_Iterable[int]] = ..., positions: _Optional[_Iterable[float]] = ..., rotations: _Optional[_Iterable[float]] = ..., pairs: _Optional[_Iterable[int]] = ..., worlds: _Optional[_Iterable[int]] = ..., groups: _Optional[_Iterable[int]] = ..., ignored_groups: _Optional[_Iterable[int]] = ..., margin: _Optional[float] = ..., accuracy: _Optional[_Union[Accuracy, _Mapping]] = ..., outputs: _Optional[_Iterable[_Union[Output, str]]] = ..., warm_starts: _Optional[_Iterable[int]] = ..., find: bool = ..., moved: _Optional[_Iterable[int]] = ..., margins: _Optional[_Iterable[float]] = ..., linear_velocities: _Optional[_Iterable[float]] = ..., angular_velocities: _Optional[_Iterable[float]] = ..., time_step: _Optional[float] = ..., turning_points: _Optional[_Iterable[float]] = ..., previous_bodies: _Optional[_Iterable[int]] = ...) -> None: ...

class QueryContactsResponse(_message.Message):
    __slots__ = ("request_id", "outcomes", "flags", "alphas", "alpha_lowers", "alpha_uppers", "separations", "normals", "point_counts", "witness_as", "distances", "witness_bs", "feature_kinds", "feature_indices", "point_ids", "bases", "pairs", "missing_hulls", "invalid_bodies", "iterations", "support_calls", "kept_areas", "previous_pairs", "previous_points", "ended_pairs", "more", "contract", "state_dropped", "unchanged", "alpha_gradients", "separation_gradients", "normal_jacobians", "gradient_errors")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    OUTCOMES_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    ALPHAS_FIELD_NUMBER: _ClassVar[int]
    ALPHA_LOWERS_FIELD_NUMBER: _ClassVar[int]
    ALPHA_UPPERS_FIELD_NUMBER: _ClassVar[int]
    SEPARATIONS_FIELD_NUMBER: _ClassVar[int]
    NORMALS_FIELD_NUMBER: _ClassVar[int]
    POINT_COUNTS_FIELD_NUMBER: _ClassVar[int]
    WITNESS_AS_FIELD_NUMBER: _ClassVar[int]
    DISTANCES_FIELD_NUMBER: _ClassVar[int]
    WITNESS_BS_FIELD_NUMBER: _ClassVar[int]
    FEATURE_KINDS_FIELD_NUMBER: _ClassVar[int]
    FEATURE_INDICES_FIELD_NUMBER: _ClassVar[int]
    POINT_IDS_FIELD_NUMBER: _ClassVar[int]
    BASES_FIELD_NUMBER: _ClassVar[int]
    PAIRS_FIELD_NUMBER: _ClassVar[int]
    MISSING_HULLS_FIELD_NUMBER: _ClassVar[int]
    INVALID_BODIES_FIELD_NUMBER: _ClassVar[int]
    ITERATIONS_FIELD_NUMBER: _ClassVar[int]
    SUPPORT_CALLS_FIELD_NUMBER: _ClassVar[int]
    KEPT_AREAS_FIELD_NUMBER: _ClassVar[int]
    PREVIOUS_PAIRS_FIELD_NUMBER: _ClassVar[int]
    PREVIOUS_POINTS_FIELD_NUMBER: _ClassVar[int]
    ENDED_PAIRS_FIELD_NUMBER: _ClassVar[int]
    MORE_FIELD_NUMBER: _ClassVar[int]
    CONTRACT_FIELD_NUMBER: _ClassVar[int]
    STATE_DROPPED_FIELD_NUMBER: _ClassVar[int]
    UNCHANGED_FIELD_NUMBER: _ClassVar[int]
    ALPHA_GRADIENTS_FIELD_NUMBER: _ClassVar[int]
    SEPARATION_GRADIENTS_FIELD_NUMBER: _ClassVar[int]
    NORMAL_JACOBIANS_FIELD_NUMBER: _ClassVar[int]
    GRADIENT_ERRORS_FIELD_NUMBER: _ClassVar[int]
    request_id: int
    outcomes: bytes
    flags: bytes
    alphas: _containers.RepeatedScalarFieldContainer[float]
    alpha_lowers: _containers.RepeatedScalarFieldContainer[float]
    alpha_uppers: _containers.RepeatedScalarFieldContainer[float]
    separations: _containers.RepeatedScalarFieldContainer[float]
    normals: _containers.RepeatedScalarFieldContainer[float]
    point_counts: _containers.RepeatedScalarFieldContainer[int]
    witness_as: _containers.RepeatedScalarFieldContainer[float]
    distances: _containers.RepeatedScalarFieldContainer[float]
    witness_bs: _containers.RepeatedScalarFieldContainer[float]
    feature_kinds: bytes
    feature_indices: _containers.RepeatedScalarFieldContainer[int]
    point_ids: _containers.RepeatedScalarFieldContainer[int]
    bases: _containers.RepeatedScalarFieldContainer[int]
    pairs: _containers.RepeatedScalarFieldContainer[int]
    missing_hulls: _containers.RepeatedScalarFieldContainer[int]
    invalid_bodies: _containers.RepeatedScalarFieldContainer[int]
    iterations: _containers.RepeatedScalarFieldContainer[int]
    support_calls: _containers.RepeatedScalarFieldContainer[int]
    kept_areas: _containers.RepeatedScalarFieldContainer[float]
    previous_pairs: _containers.RepeatedScalarFieldContainer[int]
    previous_points: _containers.RepeatedScalarFieldContainer[int]
    ended_pairs: _containers.RepeatedScalarFieldContainer[int]
    more: bool
    contract: int
    state_dropped: bool
    unchanged: bool
    alpha_gradients: _containers.RepeatedScalarFieldContainer[float]
    separation_gradients: _containers.RepeatedScalarFieldContainer[float]
    normal_jacobians: _containers.RepeatedScalarFieldContainer[float]
    gradient_errors: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, request_id: _Optional[int] = ..., outcomes: _Optional[bytes] = ..., flags: _Optional[bytes] = ..., alphas: _Optional[_Iterable[float]] = ..., alpha_lowers: _Optional[_Iterable[float]] = ..., alpha_uppers: _Optional[_Iterable[float]] = ..., separations: _Optional[_Iterable[float]] = ..., normals: _Optional[_Iterable[float]] = ..., point_counts: _Optional[_Iterable[int]] = ..., witness_as: _Optional[_Iterable[float]] = ..., distances: _Optional[_Iterable[float]] = ..., witness_bs: _Optional[_Iterable[float]] = ..., feature_kinds: _Optional[bytes] = ..., feature_indices: _Optional[_Iterable[int]] = ..., point_ids: _Optional[_Iterable[int]] = ..., bases: _Optional[_Iterable[int]] = ..., pairs: _Optional[_Iterable[int]] = ..., missing_hulls: _Optional[_Iterable[int]] = ..., invalid_bodies: _Optional[_Iterable[int]] = ..., iterations: _Optional[_Iterable[int]] = ..., support_calls: _Optional[_Iterable[int]] = ..., kept_areas: _Optional[_Iterable[float]] = ..., previous_pairs: _Optional[_Iterable[int]] = ..., previous_points: _Optional[_Iterable[int]] = ..., ended_pairs: _Optional[_Iterable[int]] = ..., more: bool = ..., contract: _Optional[int] = ..., state_dropped: bool = ..., unchanged: bool = ..., alpha_gradients: _Optional[_Iterable[float]] = ..., separation_gradients: _Optional[_Iterable[float]] = ..., normal_jacobians: _Optional[_Iterable[float]] = ..., gradient_errors: _Optional[_Iterable[float]] = ...) -> None: ...
