from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Mode(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    UNKNOWN: _ClassVar[Mode]
    OFF: _ClassVar[Mode]
    FREE: _ClassVar[Mode]
    POSITION: _ClassVar[Mode]
    TORQUE: _ClassVar[Mode]
    FAULT: _ClassVar[Mode]

class SessionState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    NO_STATE: _ClassVar[SessionState]
    IDLE: _ClassVar[SessionState]
    ARMED: _ClassVar[SessionState]
    MOVING: _ClassVar[SessionState]
    RECORDING: _ClassVar[SessionState]
    SAFE: _ClassVar[SessionState]
UNKNOWN: Mode
OFF: Mode
FREE: Mode
POSITION: Mode
TORQUE: Mode
FAULT: Mode
NO_STATE: SessionState
IDLE: SessionState
ARMED: SessionState
MOVING: SessionState
RECORDING: SessionState
SAFE: SessionState

class Reading(_message.Message):
    __slots__ = ("raw", "device_time_ns", "sequence", "flags")
    RAW_FIELD_NUMBER: _ClassVar[int]
    DEVICE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    SEQUENCE_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    raw: int
    device_time_ns: int
    sequence: int
    flags: int
    def __init__(self, raw: _Optional[int] = ..., device_time_ns: _Optional[int] = ..., sequence: _Optional[int] = ..., flags: _Optional[int] = ...) -> None: ...

class ModeCommand(_message.Message):
    __slots__ = ("mode", "target_raw", "cause")
    MODE_FIELD_NUMBER: _ClassVar[int]
    TARGET_RAW_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    mode: Mode
    target_raw: int
    cause: str
    def __init__(self, mode: _Optional[_Union[Mode, str]] = ..., target_raw: _Optional[int] = ..., cause: _Optional[str] = ...) -> None: ...

class ModeReport(_message.Message):
    __slots__ = ("mode", "status", "error_code")
    MODE_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    ERROR_CODE_FIELD_NUMBER: _ClassVar[int]
    mode: Mode
    status: int
    error_code: int
    def __init__(self, mode: _Optional[_Union[Mode, str]] = ..., status: _Optional[int] = ..., error_code: _Optional[int] = ...) -> None: ...

class Dwell(_message.Message):
    __slots__ = ("start_ns", "end_ns", "pose", "visit", "fixture")
    START_NS_FIELD_NUMBER: _ClassVar[int]
    END_NS_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    VISIT_FIELD_NUMBER: _ClassVar[int]
    FIXTURE_FIELD_NUMBER: _ClassVar[int]
    start_ns: int
    end_ns: int
    pose: int
    visit: int
    fixture: str
    def __init__(self, start_ns: _Optional[int] = ..., end_ns: _Optional[int] = ..., pose: _Optional[int] = ..., visit: _Optional[int] = ..., fixture: _Optional[str] = ...) -> None: ...

class Mark(_message.Message):
    __slots__ = ("text",)
    TEXT_FIELD_NUMBER: _ClassVar[int]
    text: str
    def __init__(self, text: _Optional[str] = ...) -> None: ...

class Fault(_message.Message):
    __slots__ = ("source", "kind", "text")
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    source: str
    kind: str
    text: str
    def __init__(self, source: _Optional[str] = ..., kind: _Optional[str] = ..., text: _Optional[str] = ...) -> None: ...

class StateChange(_message.Message):
    __slots__ = ("before", "after", "cause")
    BEFORE_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    before: SessionState
    after: SessionState
    cause: str
    def __init__(self, before: _Optional[_Union[SessionState, str]] = ..., after: _Optional[_Union[SessionState, str]] = ..., cause: _Optional[str] = ...) -> None: ...

class ClockSample(_message.Message):
    __slots__ = ("device_time_ns", "offset_ns", "uncertainty_ns", "drift_ppb", "drift_uncertainty_ppb")
    DEVICE_TIME_NS_FIELD_NUMBER: _ClassVar[int]
    OFFSET_NS_FIELD_NUMBER: _ClassVar[int]
    UNCERTAINTY_NS_FIELD_NUMBER: _ClassVar[int]
    DRIFT_PPB_FIELD_NUMBER: _ClassVar[int]
    DRIFT_UNCERTAINTY_PPB_FIELD_NUMBER: _ClassVar[int]
    device_time_ns: int
    offset_ns: int
    uncertainty_ns: int
    drift_ppb: int
    drift_uncertainty_ppb: int
    def __init__(self, device_time_ns: _Optional[int] = ..., offset_ns: _Optional[int] = ..., uncertainty_ns: _Optional[int] = ..., drift_ppb: _Optional[int] = ..., drift_uncertainty_ppb: _Optional[int] = ...) -> None: ...

class RoundTrip(_message.Message):
    __slots__ = ("shortest_ns", "longest_ns")
    SHORTEST_NS_FIELD_NUMBER: _ClassVar[int]
    LONGEST_NS_FIELD_NUMBER: _ClassVar[int]
    shortest_ns: int
    longest_ns: int
    def __init__(self, shortest_ns: _Optional[int] = ..., longest_ns: _Optional[int] = ...) -> None: ...

class LedgerEntry(_message.Message):
    __slots__ = ("expected", "received", "dropped_by_device", "dropped_by_host", "lost_in_gaps", "gaps")
    EXPECTED_FIELD_NUMBER: _ClassVar[int]
    RECEIVED_FIELD_NUMBER: _ClassVar[int]
    DROPPED_BY_DEVICE_FIELD_NUMBER: _ClassVar[int]
    DROPPED_BY_HOST_FIELD_NUMBER: _ClassVar[int]
    LOST_IN_GAPS_FIELD_NUMBER: _ClassVar[int]
    GAPS_FIELD_NUMBER: _ClassVar[int]
    expected: int
    received: int
    dropped_by_device: int
    dropped_by_host: int
    lost_in_gaps: int
    gaps: int
    def __init__(self, expected: _Optional[int] = ..., received: _Optional[int] = ..., dropped_by_device: _Optional[int] = ..., dropped_by_host: _Optional[int] = ..., lost_in_gaps: _Optional[int] = ..., gaps: _Optional[int] = ...) -> None: ...
